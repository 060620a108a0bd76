"""Coefficients against the properties of objects that they follow."""

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import Relation, RelationKind
from commonlaw.law import Law, select_objects
from commonlaw.law.parameters import coefficient_units, left_hand_sides, reach_of_equations
from commonlaw.law.printing import dependence
from commonlaw.law.quantiles import two_sided
from commonlaw.law.text import MANY
from commonlaw.plots.equations import equation_labels, term_labels
from commonlaw.plots.style import (
    COLORS,
    GREY,
    add_legend,
    axis_label,
    fitting,
    frozen_layout,
    key,
    looks,
    plain,
    styled,
)
from commonlaw.runtime.arguments import checks_types
from commonlaw.text import in_line


@dataclass(frozen=True, eq=False)
class _RelatedCoefficient:
    """Each object's own estimates of a coefficient with half their 95 % intervals, shape (objects,); its relation."""

    label: str
    unit: str
    relation: Relation
    estimates: Floats
    halves: Floats
    properties: Floats

    @property
    def panels(self) -> int:
        """How many panels show it: one for each property, and one for several together."""
        count = len(self.relation.properties)
        return count + (count > 1) or 1

    @property
    def sign(self) -> float:
        """That of the coefficients where logarithms are drawn, else 1."""
        return -1.0 if self.logarithmic and self.relation.factors[0] < 0 else 1.0

    @property
    def logarithmic(self) -> bool:
        """Whether its axes are logarithmic: it follows a power law, and no interval holds zero."""
        least = np.min(self.estimates * np.sign(self.relation.factors[0]) - self.halves)
        return self.relation.kind is RelationKind.POWER_LAW and bool(least > 0)


@styled()
@checks_types
def plot_relations(law: Law) -> Figure:
    """Plot the coefficients against the properties on which they depend, with 95 % intervals.

    Coefficients are object-specific estimates before pooling. Power laws have logarithmic axes; those of several
    properties also have a panel in which the objects collapse onto one line. The grey band contains 95 % of the
    objects, by the between-object variance. Up to fifty objects have names. Objects with only a limit of a parameter
    are left out, as in `Law.explain`.

    Raises `CommonlawError` if the law is not from `Law.explain`.

    Parameters
    ----------
    law
        From `Law.explain`.
    """
    law = select_objects(law, [name for name in law.objects if name not in law.uncertainty.limited_objects])
    rows = [*_coefficients(law)]
    columns = max(row.panels for row in rows)
    figure = Figure(figsize=fitting(1.6 + 3.1 * columns, 0.7 + 2.7 * len(rows)), layout="constrained")
    named = len(law.objects) <= MANY
    alike = {"color": COLORS[0], "marker": ".", "alpha": 0.5}
    grid, look = figure.add_gridspec(len(rows), columns), looks(law.objects) if named else {}
    for i, row in enumerate(rows):
        for k in range(row.panels):
            panel = figure.add_subplot(grid[i, k])
            _draw(panel, row, k, law)
            points = zip(law.objects, _positions(row, k), row.sign * row.estimates, row.halves, strict=True)
            for name, position, value, half in points:
                panel.errorbar(position, value, half, linestyle="none", capsize=2 * named, **look.get(name, alike))
            if k == 0:
                panel.set_ylabel(axis_label("−coefficient" if row.sign < 0 else "coefficient", row.unit))
                panel.set_title(row.label, loc="left")
    keys = [key(plain(name), linestyle="none", **style) for name, style in look.items()]
    keys.append(key("relation", color="black"))
    if any(row.relation.scatter for row in rows):
        keys.append(key("95 % of objects", color=GREY, linewidth=6, alpha=0.4))
    add_legend(figure, keys)
    return frozen_layout(figure)


def _coefficients(law: Law) -> Iterator[_RelatedCoefficient]:
    if law.uncertainty.explanation is None:
        raise CommonlawError("relations-missing-to-draw")
    estimates = law.uncertainty.own_estimates(law.coefficients[:, law.support])
    reach = reach_of_equations(law)[np.nonzero(law.support)[0]]
    halves = reach * np.sqrt(np.diagonal(estimates.covariance, axis1=1, axis2=2))
    units, lefts, terms = coefficient_units(law), equation_labels(law), term_labels(law.terms)
    sides = left_hand_sides(law)
    pairs = zip(np.argwhere(law.support), law.uncertainty.explanation.relations, strict=True)
    for i, ((j, k), relation) in enumerate(pairs):
        if relation is not None:
            known = [law.properties.get(name, {}) for name in law.objects]
            if not all({*relation.properties} <= attributes.keys() for attributes in known):
                raise CommonlawError("relations-without-properties")
            rows = [[float(attributes[name]) for name in relation.properties] for attributes in known]
            values = np.array(rows).reshape(len(law.objects), len(relation.properties))
            unit = units.get((sides[j], law.terms.names[k]), "")
            label = f"{terms[k]} in {lefts[j]}: {relation.kind}"
            yield _RelatedCoefficient(label, unit, relation, estimates.coefficients[:, i], halves[:, i], values)


def _positions(each: _RelatedCoefficient, column: int) -> Floats:
    """Return where the objects stand on a panel's horizontal axis, shape (objects,)."""
    if column < len(each.relation.properties):
        return np.asarray(each.properties[:, column])
    if not each.relation.properties:
        return np.arange(len(each.estimates), dtype=np.float64)
    columns = each.relation.columns(each.properties)
    affine = each.relation.kind is RelationKind.AFFINE
    return np.asarray(columns @ each.relation.factors if affine else columns[:, 0])


def _draw(panel: Axes, each: _RelatedCoefficient, column: int, law: Law) -> None:
    """Draw the axes of a panel, and the relation where it is a line there."""
    relation, positions = each.relation, _positions(each, column)
    if each.logarithmic:
        for axis, scale in ((panel.xaxis, panel.set_xscale), (panel.yaxis, panel.set_yscale)):
            scale("log")
            axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
    if column < len(relation.properties):
        name = relation.properties[column]
        panel.set_xlabel(axis_label(name, law.schema.units.get(name, "")))
    elif relation.properties:
        panel.set_xlabel(plain(dependence(relation), 40))
    elif len(law.objects) <= MANY:
        names = [plain(shorten(in_line(name), 20, placeholder=" …"), 60) for name in law.objects]
        panel.set_xticks(positions, names, rotation=90)
    else:
        panel.set_xlabel("objects")
    if column < len(relation.properties) and len(relation.properties) > 1:
        return  # The other properties differ between the objects: there is no one line
    ends = (positions.min(), positions.max())
    along = np.geomspace(*ends, 100) if each.logarithmic else np.linspace(*ends, 100)
    if column < len(relation.properties):
        curve = np.asarray(relation.columns(along[:, np.newaxis]) @ relation.factors)
    elif relation.properties:
        curve = along if relation.kind is RelationKind.AFFINE else relation.factors[0] * along
    else:
        curve = np.full_like(along, relation.factors[0])
    panel.plot(along, each.sign * curve, color="black", zorder=1)
    if relation.scatter:
        width = two_sided(0.95) * relation.scatter
        share = curve / (relation.factors[0] * relation.typical)
        low, high = (curve * np.exp(s * width) if relation.relative else curve + s * width * share for s in (-1, 1))
        panel.fill_between(along, each.sign * low, each.sign * high, color=GREY, alpha=0.25, zorder=0)
