// Curves as measured, and as a candidate fits or forecasts them: one figure of the objects that are chosen, and small ones of all.
import { $, element, labels, state, withUnit } from "./basics.js";
import { markPanels, showPanels, updatePanels } from "./panels.js";
import { picked } from "./edits.js";
import { draw } from "./plots.js";

const WRITTEN = { fit: true, title: "your equations" };
const MOST_TOGETHER = 3;
const wide = matchMedia("(min-width: 70rem)");

/** Show or hide what is said of a law; beside it, or below it on a narrow screen, stand the curves. */
export function showResult(shown) {
  for (const id of ["result", "take"]) $(id).hidden = !shown;
  if (!shown) for (const id of ["own", "figures", "next", "views"]) $(id).hidden = true;
  (shown ? $("result") : $("data")).after($("see"));
}

/** Begin with what was measured, before there is a law. */
export function showMeasured() {
  const { preview } = state, { roles, units } = preview;
  showResult(false);
  $("see").hidden = Boolean(preview.problem);
  if (preview.problem) return;
  begin(preview.trials, roles.states.map(name => ({ name, unit: units[name] })), true);
  showCurves();
}

/** Begin with a law: its fit, and forecasts as another view. */
export function showViews(found) {
  $("views").hidden = found.views.length < 2;
  $("view").replaceChildren(...found.views.map(({ title, held_out }, i) => element("option", `${title}${held_out ? ", held-out trials" : ""}`, { value: i })));
  beginView();
}

/** Begin with a view of a law: few objects are shown together, of many the first. */
function beginView() {
  const { found, preview } = state, trials = view()?.trials ?? [];
  begin(trials.length ? trials : preview.trials, found.states, false);
}

/** Begin with curves of equations that are written, of all trials that can be drawn. */
export function beginWritten() {
  const { preview } = state, { roles, units } = preview;
  $("views").hidden = true;
  begin(preview.trials, roles.states.map(name => ({ name, unit: units[name] })), true);
}

/** Go back from curves of equations that are written to those of the law. */
export function endWritten() {
  if (!state.written) return;
  state.written = null;
  showViews(state.found);
}

/** Show the fit, or the forecasts. */
export function changeView() {
  const j = $("state").value;
  beginView();
  $("state").value = j;
  showCurves();
}

const view = () => state.written ? WRITTEN : state.found?.views[Number($("view").value)];

function begin(trials, states, together) {
  const objects = [...new Set(trials.map(each => each.object))];
  $("states").hidden = states.length < 2;
  $("state").replaceChildren(...states.map(({ name }, j) => element("option", name, { value: j })));
  $("objects").hidden = objects.length < 2;
  $("all").hidden = objects.length <= MOST_TOGETHER;
  state.chosen = new Set(together || objects.length <= MOST_TOGETHER ? objects : objects.slice(0, 1));
  showPanels(objects, choose);
}

/** Show an object alone, or with a key held down beside the others. */
function choose(object, more) {
  const { chosen } = state;
  if (!more) state.chosen = new Set([object]);
  else if (!chosen.delete(object)) chosen.add(object);
  showCurves();
}

/** Show all objects together, or the first alone. */
export function togetherOrAlone() {
  const objects = [...new Set(curves(0).map(each => each.object))];
  state.chosen = new Set(objects.every(each => state.chosen.has(each)) ? objects.slice(0, 1) : objects);
  showCurves();
}

/** Of each trial that can be drawn what was measured of a state, and the curve of the candidate that is shown. */
function curves(j) {
  const { found, preview, at, written } = state;
  if (written) return writtenCurves(j);
  const drawn = found?.candidates[at].views[Number($("view").value)]?.curves ?? [];
  if (!drawn.length) {
    const names = labels(preview.trials);
    return preview.trials.map(({ object, name, t, states }, i) => ({ object, name, t, points: states[j], line: found ? null : states[j], label: names[i], color: i }));
  }
  const { trials } = view(), names = labels(trials);
  return trials.flatMap(({ object }, i) => {
    if (!drawn[i]) return [];
    const [points, line, low, high] = drawn[i].states[j];
    return [{ object, t: drawn[i].t, points, line, low, high, label: names[i], color: i }];
  });
}

/** The curves of a law that is compared, dashed. */
function rivalCurves(j, names) {
  const { rival, written } = state, at = Number($("view").value), drawn = rival?.views[at]?.curves;
  if (written || !drawn) return [];
  return rival.trials[at].trials.flatMap(({ object, name }, i) => {
    const color = view().trials.findIndex(each => each.object === object && each.name === name);
    if (color < 0 || !drawn[i] || !state.chosen.has(object)) return [];
    return [{ object, t: drawn[i].t, line: drawn[i].states[j][1], label: `${names[color]}, compared law`, color, dash: [6, 5] }];
  });
}

/** The same of equations that are written, whose times are those of all samples and more. */
function writtenCurves(j) {
  const { preview, written } = state, names = labels(preview.trials), k = written.states.indexOf(preview.roles.states[j]);
  return preview.trials.map((trial, i) => {
    const { t, states } = written.curves[i], measured = new Map(trial.t.map((time, n) => [time, trial.states[j][n]]));
    return { object: trial.object, t, points: t.map(time => measured.get(time) ?? null), line: states[k] ?? null, label: names[i], color: i };
  });
}

export function showCurves() {
  const { preview, written } = state, found = written ? null : state.found, j = Number($("state").value), every = curves(j), shown = every.filter(each => state.chosen.has(each.object));
  const [x, y] = found ? [found.time, found.states[j]] : [preview.roles.time, preview.roles.states[j]].map(name => ({ name, unit: preview.units[name] }));
  const modelled = every.some(each => each.line && each.line !== each.points), { fit, title } = view() ?? {};
  $("see_title").textContent = !modelled ? "Measurements" : written ? "Measurements and your equations" : fit ? "Measurements and fit" : `Measurements and ${title}`;
  const lines = fit ? "fitted" : "forecast", difference = fit ? "residual" : "error";
  const excluding = state.excluding && !modelled;
  $("exclude_mouse").hidden = modelled;
  $("log_part").hidden = !every.some(each => each.points.some(value => value > 0));
  const others = found ? rivalCurves(j, labels(view()?.trials ?? [])) : [];
  draw($("forecast_plot"), [...shown, ...others], { x: withUnit(x), y: withUnit(y), height: wide.matches ? 300 : 240, lines, log: $("log").checked && !$("log_part").hidden, picked: excluding ? picked : null, together: modelled });
  $("bands").hidden = !modelled || Boolean(written) || shown.some(each => each.low);
  const what = written ? "Lines: your equations. Below: residuals, measured minus computed." : fit ? "Lines: fit of the law, initial conditions estimated from all samples. Below: residuals, measured minus fitted." : `Lines: ${title}. Below: errors, forecast minus measured.`;
  const bands = written ? "" : "Bands: 95 % of measurements expected. ";
  $("reading").textContent = `${modelled ? `Points: measurements. ${what} ${bands}` : ""}Drag to zoom, double-click to go back.`;
  draw($("error_plot"), modelled ? shown.map(each => errors(each, fit)) : [], { x: withUnit(x), y: withUnit({ name: difference, unit: y.unit }), height: 160, points: difference, together: true, listed: false });
  $("pictures").hidden = !modelled || Boolean(written);
  for (const kind of ["svg", "png"]) $(kind).href = `searches/${state.search}/law.${kind}?candidate=${state.at}`;
  $("all").setAttribute("aria-pressed", String(shown.length === every.length));
  markPanels(shown.length < every.length ? state.chosen : new Set());
  updatePanels(every);
}

/** Residuals of a fit, or errors of a forecast, where something was measured. */
function errors({ t, points, line, label, color }, fit) {
  const kept = t.map((_, k) => k).filter(k => points[k] !== null && line[k] !== null);
  return { t: kept.map(k => t[k]), points: kept.map(k => (fit ? -1 : 1) * (line[k] - points[k])), label, color };
}
