// Equations that are written: completed and read as they are typed, their curves follow the sliders, and then they are fitted.
import { $, ask, element, plural, state, tell, tidy, trying } from "./basics.js";
import { beginWritten, showCurves } from "./curves.js";
import { equation } from "./law.js";
import { start } from "./question.js";

const written = { values: {}, ranges: {}, kept: {}, starts: {}, doses: [], fitting: false };

/** What is given about a parameter; nothing by default. */
function given(name) {
  return written.kept[name] ??= { fixed: false, low: "", high: "", shared: "object", mean: "", std: "" };
}

/** Forget what was given about other equations. */
function reset(starts = {}, doses = [], values = {}) {
  Object.assign(written, { values, ranges: {}, kept: {}, starts, doses, fitting: false });
  $("parameters").replaceChildren();
  $("starts_given").value = Object.entries(starts).map(pair => pair.join("=")).join("; ");
  for (const box of $("doses_part").querySelectorAll("input")) box.checked = doses.includes(box.value);
}

/** Begin with a table: a blank line, until a law is found. */
export function beginEquations() {
  const { objects } = state.preview;
  if (written.table !== state.table) $("equations").value = "";
  written.table = state.table;
  $("write_object").replaceChildren(element("option", "all objects", { value: "" }), ...objects.map(name => element("option", name, { value: name })));
  $("write_objects").hidden = objects.length < 2;
  const { inputs } = state.preview.roles;
  $("doses_part").hidden = !inputs.length;
  $("doses_part").replaceChildren("Doses, amounts that are added at once: ", ...inputs.map(name => {
    const label = element("label"), box = element("input", "", { type: "checkbox", value: name });
    box.addEventListener("change", () => { written.doses = [...$("doses_part").querySelectorAll(":checked")].map(each => each.value); read(); });
    label.append(box, ` ${name} `);
    return label;
  }));
  reset();
  offerStarts();
  read();
}

/** Take initial values of latent states from the form. */
export function takeGiven() {
  const pairs = $("starts_given").value.split(";").map(each => each.split("=").map(part => part.trim()));
  written.starts = Object.fromEntries(pairs.filter(([name, value]) => name && value));
  read();
}

/** Offer what the editor may start from. */
export function offerStarts() {
  const options = [["", "a blank line"]];
  if (state.found?.candidates[state.at].equations) options.push(["law", "the law shown"]);
  const groups = new Map();
  for (const { name, title, field } of state.preview.models) {
    if (!groups.has(field)) groups.set(field, element("optgroup", "", { label: field }));
    groups.get(field).append(element("option", title, { value: `model:${name}` }));
  }
  $("write_from").replaceChildren(...options.map(([value, text]) => element("option", text, { value })), ...groups.values());
}

/** Set parameters to the estimates of a law, with sliders about their intervals. */
function takeEstimates({ values, errors }, names) {
  const at = state.preview.objects.map(name => state.found.objects.indexOf(name));
  for (const name of names) {
    written.values[name] = at.map(i => values[name][Math.max(i, 0)]);
    written.ranges[name] = around(values[name], errors[name]);
  }
}

/** Show a fitted law: the editor may start from it, and where its equations were fitted, the sliders stand at the estimates. */
export function offerFound() {
  offerStarts();
  const law = state.found.candidates[0].equations;
  if (!written.fitting || !law) return;
  written.fitting = false;
  takeEstimates(law, Object.keys(written.values).filter(name => name in law.values));
  showParameters();
}

export function startFrom() {
  const from = $("write_from").value, law = from === "law" ? state.found.candidates[state.at].equations : null;
  const model = state.preview.models.find(each => `model:${each.name}` === from);
  reset(law?.starts, (law ?? model)?.doses);
  if (law) takeEstimates(law, Object.keys(law.values));
  $("equations").value = (law ?? model)?.text ?? "";
  $("initial_time").value = law?.initial_time ?? "";
  $("given").open = Boolean(Object.keys(written.starts).length || written.doses.length);
  read();
}

/** Put equations that were fitted before into the editor, with all that was given. */
export function restoreEquations({ text, values, fixed, bounds, shared, priors, starts, initial_time, doses }) {
  reset(starts, doses, values);
  for (const name of Object.keys(values)) {
    const [low, high] = bounds[name] ?? [null, null], [mean, std] = priors[name] ?? ["", ""];
    written.kept[name] = { fixed: fixed.includes(name), low: low ?? "", high: high ?? "", shared: shared[name] ?? "object", mean, std };
  }
  $("equations").value = text;
  $("initial_time").value = initial_time ?? "";
  $("parameters_part").hidden = false;
  showParameters();
  $("write").open = true;
}

/** The range of a slider: about the intervals of all objects, or a decade either side. */
function around(values, half = 0) {
  const least = Math.min(...values), most = Math.max(...values), reach = Math.max(4 * half, 0.1 * Math.max(Math.abs(least), Math.abs(most)));
  if (half) return [least - reach, most + reach];
  if (least > 0) return [least / 10, most * 10];
  if (most < 0) return [least * 10, most / 10];
  const size = Math.max(-least, most) || 1;
  return [-10 * size, 10 * size];
}

/** The time of initial values: a number, or a word for the server to read, and nothing for the default. */
function initialTime() {
  const text = $("initial_time").value.trim();
  return text === "" ? null : Number.isNaN(Number(text)) ? text : Number(text);
}

/** The equations with all that is given, as the server takes them. */
function asked() {
  const kept = Object.keys(written.values).map(name => [name, given(name)]), number = text => text === "" ? null : Number(text);
  return {
    text: $("equations").value, values: written.values, starts: written.starts, doses: written.doses,
    initial_time: initialTime(),
    fixed: kept.filter(([, each]) => each.fixed).map(([name]) => name),
    bounds: Object.fromEntries(kept.filter(([, each]) => each.low !== "" || each.high !== "").map(([name, { low, high }]) => [name, [number(low), number(high)]])),
    shared: Object.fromEntries(kept.filter(([, each]) => each.shared !== "object").map(([name, { shared }]) => [name, shared])),
    priors: Object.fromEntries(kept.filter(([, each]) => each.mean !== "" && each.std !== "").map(([name, { mean, std }]) => [name, [Number(mean), Number(std)]])),
  };
}

let waiting = false, again = false, changes = 0;

/** Read the equations and draw their curves; while the server answers, only the last of further changes counts. */
export async function read() {
  clearTimeout(resting);
  changes += 1;
  if (waiting) { again = true; return; }
  waiting = true;
  try {
    do {
      again = false;
      const before = changes;
      let found = { problem: "", formula: [], values: {}, curves: [] };
      await trying("equations_problem", async () => {
        if ($("equations").value.trim()) found = await ask("equations", "POST", { table: state.table, columns: state.columns, equations: asked() });
        if (changes === before) showRead(found);
      });
    } while (again);
  } finally {
    waiting = false;
  }
}

const REST = 150;
let following = false, resting = 0, moved = 0;
const stale = new Set();

/**
 * Let curves of the objects at some indices follow a slider from their last initial values: those that the server computes
 * at once, and the others in turn. When the slider rests, the initial values are estimated anew.
 */
async function followSlider(objects) {
  moved = performance.now();
  changes += 1;
  clearTimeout(resting);
  resting = setTimeout(read, REST);
  if (!state.written) return;
  state.written.curves.forEach(({ object }, i) => objects.includes(object) && stale.add(i));
  if (following) return;
  following = true;
  await trying("equations_problem", async () => {
    while (stale.size) {
      const before = changes, since = moved, { curves } = state.written, given = { trials: [...stale], initial: curves.map(each => each.initial) };
      const found = await ask("equations", "POST", { table: state.table, columns: state.columns, equations: asked(), moved: given });
      if (state.written?.curves !== curves) break;
      for (const [i, states] of found.curves) {
        curves[i].states = states;
        stale.delete(i);
        if (changes !== before) stale.add(i);
      }
      showCurves();
      document.body.dataset.followed = (performance.now() - since).toFixed(1);
    }
  });
  stale.clear();
  following = false;
}

function showRead({ problem, formula, values, curves, states }) {
  tell($("equations_problem"), problem);
  if (problem) return;
  $("equations_formula").replaceChildren(...formula.map(equation));
  written.values = values;
  $("parameters_part").hidden = !curves.length;
  showParameters();
  const had = Boolean(state.written);
  state.written = curves.length ? { curves, states } : null;
  if (state.written && !had) beginWritten();
  if (state.written || had) showCurves();
}

/** Show a row for each parameter; rows of parameters that were there stay, so that a slider can be dragged on. */
function showParameters() {
  const names = Object.keys(written.values), rows = [...$("parameters").children];
  if (rows.map(row => row.dataset.name).join() !== names.join()) $("parameters").replaceChildren(...names.map(name => rows.find(row => row.dataset.name === name) ?? row(name)));
  for (const line of $("parameters").children) showValue(line);
}

function objectAt() {
  return state.preview.objects.indexOf($("write_object").value);
}

/** Show the value of a parameter: of the object that is chosen, or the mean of all. */
export function showValue(line) {
  const { name } = line.dataset, values = written.values[name], at = objectAt();
  const value = at < 0 ? values.reduce((sum, each) => sum + each, 0) / values.length : values[at];
  let range = written.ranges[name] ??= around(values);
  if (value < range[0] || value > range[1]) range = written.ranges[name] = around([value]);
  const [slider, number] = line.querySelectorAll("input");
  slider.value = position(value, range);
  slider.setAttribute("aria-valuetext", String(tidy(value)));
  if (document.activeElement !== number) number.value = Number(value.toPrecision(5));
}

export function showValues() {
  for (const line of $("parameters").children) showValue(line);
}

const STEPS = 1000, DECADES = 5;

/** Whether a range is so wide that its slider moves by factors. */
function byFactors([low, high]) {
  return low * high > 0 && Math.max(low / high, high / low) > DECADES;
}

function position(value, [low, high]) {
  const share = byFactors([low, high]) ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(STEPS * share);
}

function valueAt(place, [low, high]) {
  const share = place / STEPS;
  return byFactors([low, high]) ? low * (high / low) ** share : low + share * (high - low);
}

function set(name, value) {
  const at = objectAt();
  written.values[name] = written.values[name].map((old, i) => at < 0 || i === at ? value : old);
  followSlider(at < 0 ? state.preview.objects : [state.preview.objects[at]]);
}

function row(name) {
  const id = `parameter_${name}`, line = element("div", "", { class: "parameter", "data-name": name });
  const slider = element("input", "", { type: "range", id, min: 0, max: STEPS, step: 1 });
  const number = element("input", "", { type: "number", step: "any", "aria-label": `Value of ${name}` });
  const more = element("button", "More", { "aria-expanded": "false", "aria-label": `More about ${name}` }), fields = about(name);
  slider.addEventListener("input", () => { set(name, Number(valueAt(Number(slider.value), written.ranges[name]).toPrecision(5))); });
  number.addEventListener("change", () => { if (number.value !== "" && Number.isFinite(Number(number.value))) set(name, Number(number.value)); });
  more.addEventListener("click", () => { fields.hidden = !fields.hidden; more.setAttribute("aria-expanded", String(!fields.hidden)); });
  line.append(element("label", name, { for: id }), slider, number, more, fields);
  return line;
}

/** What may be given about a parameter: fixed, bounds, what it is shared by, a prior. */
function about(name) {
  const fields = element("div", "", { class: "more" }), kept = given(name);
  fields.hidden = true;
  const labelled = (text, field) => { const label = element("label", `${text} `); label.append(field); fields.append(label); return field; };
  const number = (text, key) => {
    const field = labelled(text, element("input", "", { type: "number", step: "any" }));
    field.value = kept[key];
    field.addEventListener("change", () => { kept[key] = field.value; });
  };
  const fixed = labelled("Fixed", element("input", "", { type: "checkbox" }));
  fixed.checked = kept.fixed;
  fixed.addEventListener("change", () => {
    kept.fixed = fixed.checked;
    const values = written.values[name];
    if (kept.fixed) { written.values[name] = values.map(() => values.reduce((sum, each) => sum + each, 0) / values.length); read(); }
  });
  number("Minimum", "low");
  number("Maximum", "high");
  const groups = Object.entries(state.preview.groups);
  if (groups.length) {
    const shared = labelled("Value", element("select"));
    shared.append(...[["object", "object-specific"], ...groups].map(([value, text]) => element("option", text, { value })));
    shared.value = kept.shared;
    shared.addEventListener("change", () => { kept.shared = shared.value; });
  }
  number("Prior mean", "mean");
  number("Prior SD", "std");
  return fields;
}

/** Fit the equations as they are written, as a search. */
export async function fit() {
  const equations = asked(), fixed = equations.fixed.length;
  if (fixed && fixed === Object.keys(equations.values).length) return tell($("equations_problem"), `all ${plural(fixed, "parameter")} are fixed: leave one to be estimated`);
  written.fitting = true;
  return start({ equations });
}

// Completion of the word before the caret

let offered = [], chosen = 0;

function wordBefore() {
  const field = $("equations"), before = field.value.slice(0, field.selectionStart);
  return before.match(/[\p{L}_][\p{L}\p{N}_]*$/u)?.[0] ?? "";
}

export function complete() {
  const word = wordBefore(), fits = each => each.toLowerCase().startsWith(word.toLowerCase()) && each !== word;
  offered = word ? [...state.preview.words, ...Object.keys(written.values)].filter(fits).slice(0, 12) : [];
  chosen = 0;
  showOffered();
}

function showOffered() {
  $("completions").hidden = !offered.length;
  $("completions").replaceChildren(...offered.map((text, i) => {
    const item = element("li", text, { role: "option", id: `completion_${i}`, "aria-selected": String(i === chosen) });
    item.addEventListener("pointerdown", event => { event.preventDefault(); accept(i); });
    return item;
  }));
  if (offered.length) $("equations").setAttribute("aria-activedescendant", `completion_${chosen}`);
  else $("equations").removeAttribute("aria-activedescendant");
}

export function close() {
  offered = [];
  showOffered();
}

function accept(i) {
  const field = $("equations"), at = field.selectionStart, from = at - wordBefore().length;
  field.setRangeText(offered[i], from, at, "end");
  close();
  read();
}

/** Arrows choose among what is offered, Tab takes it, Escape puts it away; Enter stays a new line. */
export function steer(event) {
  if (!offered.length) return;
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
  if (step) { chosen = (chosen + step + offered.length) % offered.length; showOffered(); }
  else if (event.key === "Tab" && !event.shiftKey) accept(chosen);
  else if (event.key === "Escape") close();
  else return;
  event.preventDefault();
}
