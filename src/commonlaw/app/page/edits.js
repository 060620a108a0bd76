// Changes of the measurements: what is left out, by the mouse or in a form, and blanks that are subtracted; each can be undone.
import { $, element, state, tidy, trying } from "./basics.js";
import { showCurves } from "./curves.js";
import { recognise } from "./measurements.js";
import { saveAgain } from "./sessions.js";

const said = value => String(tidy(value));

/** Show the form and the changes until now, also where they leave nothing to be drawn. */
export function showEdits() {
  const { preview } = state, edits = state.columns.edits ?? [], objects = preview.objects ?? [];
  $("edit_object").replaceChildren(element("option", "all objects", { value: "" }), ...objects.map(name => element("option", name, { value: name })));
  $("blanks").replaceChildren(...objects.map(name => new Option(name, name, false, /blank/i.test(name))));
  $("blanks_part").hidden = objects.length < 2;
  $("edits").replaceChildren(...edits.map(edit => element("li", inWords(edit))));
  $("edit").querySelector("summary").textContent = `Exclude data and subtract blanks${edits.length ? ` (${edits.length})` : ""}`;
  for (const id of ["undo", "undo_see"]) $(id).hidden = !edits.length;
  if (edits.length && preview.problem) $("edit").open = true;
}

function inWords({ object, trial, between, blanks }) {
  if (blanks?.length) return `Subtracted as blanks: ${blanks.join(", ")}`;
  const what = [object ?? "all objects", ...trial ? [`trial ${trial}`] : []].join(", ");
  return `Excluded: ${what}${between ? `, ${state.preview.roles?.time ?? "time"} ${said(between[0])} to ${said(between[1])}` : ""}`;
}

/** Make a change; a law of other measurements is shown no more. */
async function change(edits) {
  state.columns = { ...state.columns, edits };
  Object.assign(state, { found: null, search: null });
  await trying("failure", recognise);
  await saveAgain();
}

const add = (...more) => change([...state.columns.edits ?? [], ...more]);

export const undo = () => change((state.columns.edits ?? []).slice(0, -1));

/** Exclude what the form says. */
export function exclude() {
  const [first, last] = ["edit_first", "edit_last"].map(id => $(id).value), object = $("edit_object").value;
  if (!object && first === "" && last === "") return $("edit_object").focus();
  const between = first === "" && last === "" ? null : [first === "" ? -1e300 : Number(first), last === "" ? 1e300 : Number(last)];
  return add({ object: object || null, between });
}

export function subtractBlanks() {
  const blanks = [...$("blanks").selectedOptions].map(each => each.value);
  if (blanks.length) return add({ blanks });
  return $("blanks").focus();
}

/** Let the mouse exclude in place of zooming, or again zoom. */
export function toggleMouse() {
  state.excluding = !state.excluding;
  $("exclude_mouse").setAttribute("aria-pressed", String(state.excluding));
  showCurves();
}

/** What the mouse excludes: a range of times of the objects that are shown, or the trial of a curve that is clicked. */
export const picked = {
  range(first, last) {
    const objects = state.preview.objects, shown = objects.filter(each => state.chosen.has(each));
    return add(...shown.length === objects.length ? [{ between: [first, last] }] : shown.map(object => ({ object, between: [first, last] })));
  },
  curve({ object, name }) {
    const several = state.preview.trials.filter(each => each.object === object).length > 1;
    return add({ object, trial: several ? name : null });
  },
};
