// A forecast of one's own: an object, where it starts, and for how long.
import { $, ask, element, state, tidy, trying, withUnit } from "./basics.js";
import { draw } from "./plots.js";

export function showOwn(found) {
  $("own").hidden = found.inputs.length > 0;
  const unseen = found.follows.length ? [element("option", "a new object", { value: "" })] : [];
  $("own_object").replaceChildren(...found.objects.map(name => element("option", name, { value: name })), ...unseen);
  $("own_properties").replaceChildren(...found.follows.flatMap((name, j) => [
    element("label", name, { for: `property_${j}` }), element("input", "", { id: `property_${j}`, type: "number", step: "any", value: 1, "data-name": name }),
  ]));
  const first = found.candidates.find(each => each.chosen).views[0]?.curves[0];
  $("starts").replaceChildren(...[...found.states, ...found.rates].flatMap((each, j) => {
    const value = tidy(first?.states[j]?.[1]?.find(number => number !== null) ?? 0);
    return [element("label", `Initial ${withUnit(each)}`, { for: `start_${j}` }), element("input", "", { id: `start_${j}`, type: "number", step: "any", value })];
  }));
  $("duration_label").textContent = withUnit({ name: "Duration", unit: found.time.unit });
  $("duration").value = first ? tidy(first.t.at(-1) - first.t[0]) || 1 : 1;
  for (const input of $("own").querySelectorAll("#starts input, #own_properties input")) input.addEventListener("change", forecastOwn);
}

export async function forecastOwn() {
  if (!state.found || state.found.inputs.length) return;
  await trying("own_failed", async () => {
    const start = [...$("starts").querySelectorAll("input")].map(each => Number(each.value));
    const object = $("own_object").value;
    $("own_properties").hidden = Boolean(object);
    const properties = object ? {} : Object.fromEntries([...$("own_properties").querySelectorAll("input")].map(each => [each.dataset.name, Number(each.value)]));
    const asked = { candidate: state.at, object: object || "your own", start, duration: Number($("duration").value), properties };
    const { t, states, outcome } = await ask(`searches/${state.search}/forecasts`, "POST", asked);
    $("own_failed").textContent = outcome;
    const curves = states.map(({ line, low, high }, j) => ({ t, line, low, high, label: withUnit(state.found.states[j]), color: j }));
    $("own_bands").hidden = !curves.some(each => each.low);
    draw($("own_plot"), curves, { x: withUnit(state.found.time), y: curves.length > 1 ? "" : curves[0].label, height: 240, dragged });
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
