// Plots of what was measured and forecast, by uPlot; colours after Okabe and Ito (2008).

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b07a00", "#3a9bd6", "#882255", "#7a7a20", "#7f7f7f", "#a05a2c"];
const shown = new Map();

/** The colour of a curve by its index. */
export function colorOf(index) {
  return COLORS[index % COLORS.length];
}

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function axis(label) {
  return { stroke: css("--ink"), grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line") }, label, labelSize: 22, labelFont: "12px system-ui, sans-serif" };
}

/** How wide the numbers beside an axis are. */
function width(_, numbers) {
  return 28 + 7 * Math.max(5, ...(numbers ?? []).map(each => String(each).length));
}

/**
 * Draw curves into a place: each has times, label, color index, and as far as there are any points, a line, and low and high
 * ends of a band. `log` is for a logarithmic axis, without what is not positive. `picked` takes a range of times that is dragged
 * over, in place of zooming, or a curve that is clicked. Figures that stand `together` have one time axis, and one list of curves,
 * which is below the figure that is `listed`. Where `dragged` is given, it takes the curve that is dragged, and the value of its start.
 */
export function draw(place, curves, { x, y, height = 300, dragged = null, lines = "forecast", points = "measured", log = false, picked = null, together = false, listed = true }) {
  const series = [{}], bands = [], tables = [];
  for (const curve of curves) {
    const color = colorOf(curve.color), columns = [curve.t];
    const add = (values, settings) => { columns.push(log ? values.map(each => each > 0 ? each : null) : values); series.push({ spanGaps: true, scale: "y", stroke: color, pxAlign: 0, ...settings }); };
    if (curve.low) {
      bands.push({ series: [series.length, series.length + 1], fill: `${color}2e` });
      for (const end of [curve.high, curve.low]) add(end, { stroke: "transparent", points: { show: false } });
    }
    if (curve.line) add(curve.line, { width: 2, dash: curve.dash, points: { show: false } });
    if (curve.points) add(curve.points, { width: 0, paths: () => null, points: { show: true, size: 5, fill: color, width: 0 } });
    tables.push(columns);
  }
  const data = tables.length > 1 ? uPlot.join(tables) : tables[0];
  const key = JSON.stringify([series, bands, curves.map(each => each.label), x, y, height, lines, points, log, together, listed, Boolean(dragged), Boolean(picked), css("--ink"), place.clientWidth]), before = shown.get(place);
  if (before?.key === key && !dragged) {
    // The same lines with other values: they move, and nothing is made anew
    before.content.curves = curves;
    return before.plot.setData(data);
  }
  before?.plot.destroy();
  shown.delete(place);
  place.replaceChildren();
  if (!tables.length) return;
  const content = { curves }, held = holding.get(place), told = readout(content, { x, lines, points });
  const options = {
    width: Math.max(280, place.clientWidth), height, series, bands,
    scales: { x: { time: false }, y: { range: (_, low, high) => held ? held.range : within(low, high, content.curves, log), distr: log ? 3 : 1 } },
    axes: [{ ...axis(x), size: 40 }, { ...axis(y), size: width, space: Math.min(30, height / 8) }],
    legend: { show: false }, hooks: { setCursor: [told.show], setSelect: picked ? [plot => pickRange(plot, picked)] : [] },
    cursor: { points: { show: false }, drag: { x: !dragged, y: !dragged && !picked, setScale: !dragged && !picked, uni: 20 }, ...together ? { sync: { key: "together", scales: ["x", null] } } : {} },
  };
  const plot = new uPlot(options, data, place);
  if (listed) place.append(told.list);
  shown.set(place, { plot, key, content, again: () => draw(place, content.curves, { x, y, height, dragged, lines, points, log, picked, together, listed }) });
  if (picked) letClick(plot, content, picked);
  if (dragged) letDrag(place, plot, curves.map(each => each.line), dragged);
}

const MOST_NAMED = 6;

/** A list of the curves, with their values under the pointer; of many curves only the one nearest to the pointer. */
function readout(content, words) {
  const list = document.createElement("ul"), { curves: first } = content, few = first.length <= MOST_NAMED;
  list.className = "readout";
  const rows = (few ? first : [null]).map(() => list.appendChild(document.createElement("li")));
  const tell = (row, curve, values) => {
    const swatch = document.createElement("span");
    swatch.style.background = colorOf(curve.color);
    row.replaceChildren(swatch, `${curve.label}${values}`);
  };
  const rest = () => {
    if (few) first.forEach((curve, i) => tell(rows[i], curve, ""));
    else rows[0].textContent = `${first.length} curves: point at one to see which it is`;
  };
  rest();
  const show = plot => {
    const { left, top } = plot.cursor, { curves } = content;
    if (!(left >= 0)) return rest();
    const at = plot.posToVal(left, "x"), range = plot.scales.x.max - plot.scales.x.min;
    if (few) return curves.forEach((curve, i) => tell(rows[i], curve, valuesAt(curve, at, range, words)));
    const height = plot.posToVal(top, "y"), off = curve => Math.abs(nearest(curve.t, curve.line ?? curve.points, at).value - height);
    const curve = curves.reduce((best, each) => off(each) < off(best) ? each : best);
    tell(rows[0], curve, valuesAt(curve, at, range, words));
  };
  return { list, show };
}

/** The value that is nearest in time to a moment, and when that is. */
function nearest(times, values, at) {
  let best = { time: Infinity, value: NaN };
  times.forEach((time, i) => { if (values[i] !== null && Math.abs(time - at) < Math.abs(best.time - at)) best = { time, value: values[i], i }; });
  return best;
}

/** What a curve says at a moment; a measurement only if one is near. */
function valuesAt(curve, at, range, { x, lines, points }) {
  const number = value => Number(value.toPrecision(4)), parts = [];
  const line = curve.line && nearest(curve.t, curve.line, at), point = curve.points && nearest(curve.t, curve.points, at);
  const time = point && Math.abs(point.time - at) < range / 40 ? point.time : line?.time ?? at;
  const here = curve.line && nearest(curve.t, curve.line, time);
  if (here?.i !== undefined && curve.line !== curve.points) parts.push(`${lines} ${number(here.value)}`);
  if (curve.low && here?.i !== undefined) parts[0] += ` (${number(curve.low[here.i])} to ${number(curve.high[here.i])})`;
  if (point?.time === time) parts.push(`${points} ${number(point.value)}`);
  return parts.length ? `: ${parts.join(", ")} at ${x} ${number(time)}` : "";
}

const LEAST = 4;

function pickRange(plot, picked) {
  const { left, width } = plot.select;
  if (width >= LEAST) picked.range(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
}

/** Let a click choose the curve nearest to the pointer. */
function letClick(plot, content, picked) {
  let from = 0;
  plot.over.addEventListener("mousedown", event => { from = event.clientX; });
  plot.over.addEventListener("mouseup", event => {
    if (Math.abs(event.clientX - from) >= LEAST) return;
    const box = plot.over.getBoundingClientRect(), at = plot.posToVal(event.clientX - box.left, "x"), value = plot.posToVal(event.clientY - box.top, "y");
    const off = curve => Math.abs(nearest(curve.t, curve.points ?? curve.line, at).value - value);
    picked.curve(content.curves.reduce((best, each) => off(each) < off(best) ? each : best));
  });
}

/** The range of the axis: what is seen, and of bands what lies within half of its span beyond measured points and lines. */
function within(low, high, curves, log = false) {
  const main = curves.flatMap(each => [...(each.points ?? []), ...(each.line ?? [])]).filter(each => each !== null && (each > 0 || !log));
  if (log) return main.length ? [Math.min(...main) / 1.3, Math.max(...main) * 1.3] : [0.1, 10];
  const least = Math.min(...main), most = Math.max(...main), span = most - least || Math.abs(most) || 1;
  const from = Math.max(low ?? least, least - span / 2), to = Math.min(high ?? most, most + span / 2);
  return [from - span / 20, to + span / 20];
}

const holding = new Map();

/** Let the curve nearest to the pointer be dragged up and down; the scale stays until it is let go. */
function letDrag(place, plot, lines, dragged) {
  const value = event => plot.posToVal(event.clientY - plot.over.getBoundingClientRect().top, "y");
  const move = event => {
    const held = holding.get(place);
    dragged(held.curve, held.start + shown.get(place).plot.posToVal(event.clientY - shown.get(place).plot.over.getBoundingClientRect().top, "y") - held.from);
  };
  const end = () => {
    removeEventListener("pointermove", move);
    holding.delete(place);
  };
  plot.over.style.touchAction = "none";
  plot.over.addEventListener("pointerdown", event => {
    const at = plot.posToIdx(event.clientX - plot.over.getBoundingClientRect().left), from = value(event);
    const far = lines.map(values => Math.abs((values[at] ?? Infinity) - from));
    const curve = far.indexOf(Math.min(...far)), { min, max } = plot.scales.y;
    holding.set(place, { curve, from, start: lines[curve][0], range: [min, max] });
    addEventListener("pointermove", move);
    addEventListener("pointerup", end, { once: true });
  });
}

addEventListener("resize", () => {
  for (const [place, { plot }] of shown) plot.setSize({ width: Math.max(280, place.clientWidth), height: plot.height });
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const { again } of [...shown.values()]) again(); });
