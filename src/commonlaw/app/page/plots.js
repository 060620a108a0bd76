// Plots of what was measured and forecast, by uPlot; colours after Okabe and Ito (2008).

const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b07a00", "#3a9bd6", "#882255", "#7a7a20", "#7f7f7f", "#a05a2c"];
const shown = new Map();

function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

function axis(label) {
  return { stroke: css("--ink"), grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line") }, label, labelSize: 22, size: 56 };
}

/** Draw curves into a place: each has times, values, label, color index, and a kind: points, line, or band with low and high. */
export function draw(place, curves, { x, y, height = 300 }) {
  const series = [{ label: x }], bands = [], tables = [];
  for (const curve of curves) {
    const color = COLORS[curve.color % COLORS.length], columns = [curve.t];
    const add = (values, settings) => { columns.push(values); series.push({ spanGaps: true, scale: "y", ...settings }); };
    if (curve.low) {
      const at = series.length;
      add(curve.high, { label: `${curve.label} high`, stroke: "transparent", points: { show: false } });
      add(curve.low, { label: `${curve.label} low`, stroke: "transparent", points: { show: false } });
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
    legend: { show: curves.length <= 6 }, cursor: { drag: { x: true, y: true, uni: 20 } },
  };
  shown.set(place, new uPlot(options, data, place));
}

addEventListener("resize", () => {
  for (const [place, plot] of shown) plot.setSize({ width: Math.max(280, place.clientWidth), height: plot.height });
});
