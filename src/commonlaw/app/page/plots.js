// Plots of what was measured and forecast, by uPlot; colours after Okabe and Ito (2008).

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b07a00", "#3a9bd6", "#882255", "#7a7a20", "#7f7f7f", "#a05a2c"];
const shown = new Map();

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function axis(label) {
  return { stroke: css("--ink"), grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line") }, label, labelSize: 22, size: 56 };
}

/**
 * Draw curves into a place: each has times, label, color index, and as far as there are any points, a line, and low and high
 * ends of a band. Where `dragged` is given, it takes the curve that is dragged, and the value of its start.
 */
export function draw(place, curves, { x, y, height = 300, dragged = null }) {
  const series = [{ label: x }], bands = [], tables = [];
  for (const curve of curves) {
    const color = COLORS[curve.color % COLORS.length], columns = [curve.t];
    const add = (values, settings) => { columns.push(values); series.push({ spanGaps: true, scale: "y", ...settings }); };
    if (curve.low) {
      const at = series.length;
      const end = { stroke: "transparent", points: { show: false }, class: "end" };
      add(curve.high, { ...end, label: `${curve.label} high` });
      add(curve.low, { ...end, label: `${curve.label} low` });
      bands.push({ series: [at, at + 1], fill: `${color}2e` });
    }
    if (curve.line) add(curve.line, { label: curve.label, stroke: color, width: 2, points: { show: false } });
    if (curve.points) {
      add(curve.points, { label: `${curve.label} measured`, stroke: color, width: 0, paths: () => null, points: { show: true, size: 5, fill: color, width: 0 } });
    }
    tables.push(columns);
  }
  shown.get(place)?.destroy();
  shown.delete(place);
  place.replaceChildren();
  if (!tables.length) return;
  const data = tables.length > 1 ? uPlot.join(tables) : tables[0];
  const options = {
    width: Math.max(280, place.clientWidth), height, series, bands,
    scales: { x: { time: false } }, axes: [{ ...axis(x), size: 40 }, axis(y)],
    legend: { show: curves.length <= 6 }, cursor: { drag: { x: !dragged, y: !dragged, setScale: !dragged, uni: 20 } },
  };
  const held = holding.get(place);
  options.scales.y = { range: (_, low, high) => held ? held.range : within(low, high, curves) };
  const plot = new uPlot(options, data, place);
  shown.set(place, plot);
  if (dragged) letDrag(place, plot, dragged);
}

/** The range of the axis: what is seen, and of bands what lies within half of its span beyond measured points and lines. */
function within(low, high, curves) {
  const main = curves.flatMap(each => [...(each.points ?? []), ...(each.line ?? [])]).filter(each => each !== null);
  const least = Math.min(...main), most = Math.max(...main), span = most - least || Math.abs(most) || 1;
  const from = Math.max(low ?? least, least - span / 2), to = Math.min(high ?? most, most + span / 2);
  return [from - span / 20, to + span / 20];
}

const holding = new Map();

/** Let the curve nearest to the pointer be dragged up and down; the scale stays until it is let go. */
function letDrag(place, plot, dragged) {
  const value = event => plot.posToVal(event.clientY - plot.over.getBoundingClientRect().top, "y");
  const move = event => {
    const held = holding.get(place);
    dragged(held.curve, held.start + shown.get(place).posToVal(event.clientY - shown.get(place).over.getBoundingClientRect().top, "y") - held.from);
  };
  const end = () => {
    removeEventListener("pointermove", move);
    holding.delete(place);
  };
  plot.over.style.touchAction = "none";
  plot.over.addEventListener("pointerdown", event => {
    const at = plot.posToIdx(event.clientX - plot.over.getBoundingClientRect().left), from = value(event);
    const far = plot.data.slice(1).map(values => Math.abs((values[at] ?? Infinity) - from));
    const curve = far.indexOf(Math.min(...far)), { min, max } = plot.scales.y;
    holding.set(place, { curve, from, start: plot.data[curve + 1][0], range: [min, max] });
    addEventListener("pointermove", move);
    addEventListener("pointerup", end, { once: true });
  });
}

addEventListener("resize", () => {
  for (const [place, plot] of shown) plot.setSize({ width: Math.max(280, place.clientWidth), height: plot.height });
});
