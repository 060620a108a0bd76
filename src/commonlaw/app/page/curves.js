// 4. Curves as measured and forecast, and 5. a forecast of one's own.
import { $, ask, element, labels, state, trying, withUnit } from "./basics.js";
import { draw } from "./plots.js";

const MOST_SHOWN = 3;

export function showTrialChoices(found) {
  const names = labels(found.trials);
  $("trials").replaceChildren(...found.trials.map((_, i) => {
    const label = element("label"), box = element("input", "", { type: "checkbox", value: i });
    box.checked = i < MOST_SHOWN;
    label.append(box, ` ${names[i]}`);
    return label;
  }));
}

export function showCurves() {
  const found = state.found, candidate = found.candidates[state.at], names = labels(found.trials), j = Number($("state").value);
  const chosen = [...$("trials").querySelectorAll("input:checked")].map(each => Number(each.value)).filter(i => candidate.curves[i]);
  const curves = chosen.map(i => {
    const [points, line, low, high] = candidate.curves[i].states[j];
    return { t: candidate.curves[i].t, points, line, low, high, label: names[i], color: i };
  });
  const x = withUnit(found.time), name = withUnit(found.states[j]);
  draw($("forecast_plot"), curves, { x, y: name });
  $("bands").hidden = curves.some(each => each.low) || !curves.length;
  const errors = curves.map(({ t, points, line, label, color }) => {
    const kept = t.map((_, k) => k).filter(k => points[k] !== null && line[k] !== null);
    return { t: kept.map(k => t[k]), points: kept.map(k => line[k] - points[k]), label, color };
  });
  draw($("error_plot"), errors, { x, y: "off by", height: 180, points: "forecast less measured" });
}

export function showOwn(found) {
  $("own").hidden = found.inputs.length > 0;
  const unseen = found.follows.length ? [element("option", "one of your own", { value: "" })] : [];
  $("own_object").replaceChildren(...found.objects.map(name => element("option", name, { value: name })), ...unseen);
  $("own_properties").replaceChildren(...found.follows.flatMap((name, j) => [
    element("label", name, { for: `property_${j}` }), element("input", "", { id: `property_${j}`, type: "number", step: "any", value: 1, "data-name": name }),
  ]));
  const names = [...found.states.map(each => each.name), ...found.rates], first = found.candidates.find(each => each.chosen).curves[0];
  $("starts").replaceChildren(...names.flatMap((name, j) => {
    const value = first?.states[j]?.[1]?.find(each => each !== null) ?? 0;
    return [element("label", `${name} at the start`, { for: `start_${j}` }), element("input", "", { id: `start_${j}`, type: "number", step: "any", value })];
  }));
  $("duration_label").textContent = withUnit({ name: "For how long", unit: found.time.unit });
  $("duration").value = first ? first.t.at(-1) - first.t[0] || 1 : 1;
  for (const input of $("own").querySelectorAll("#starts input, #own_properties input")) input.addEventListener("change", forecastOwn);
}

export async function forecastOwn() {
  if (state.found.inputs.length) return;
  await trying("own_failed", async () => {
    const start = [...$("starts").querySelectorAll("input")].map(each => Number(each.value));
    const object = $("own_object").value;
    $("own_properties").hidden = Boolean(object);
    const properties = object ? {} : Object.fromEntries([...$("own_properties").querySelectorAll("input")].map(each => [each.dataset.name, Number(each.value)]));
    const asked = { candidate: state.at, object: object || "your own", start, duration: Number($("duration").value), properties };
    const { t, states, outcome } = await ask(`searches/${state.search}/forecasts`, "POST", asked);
    $("own_failed").textContent = outcome;
    const curves = states.map((line, j) => ({ t, line, label: withUnit(state.found.states[j]), color: j }));
    draw($("own_plot"), curves, { x: withUnit(state.found.time), y: curves.length > 1 ? "" : curves[0].label, height: 220, dragged });
  });
}

let waiting = false;

/** The start of a state was dragged to a value; forecasts follow as fast as they come. */
async function dragged(j, value) {
  $(`start_${j}`).value = Number(value.toPrecision(4));
  if (waiting) return;
  waiting = true;
  await forecastOwn();
  waiting = false;
}

