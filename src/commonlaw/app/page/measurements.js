// 1. Measurements: a table, what its columns are, what its checks found.
import { $, ask, element, fill, plural, remember, state, tell, trying } from "./basics.js";
import { showEdits } from "./edits.js";
import { showMeasured } from "./curves.js";
import { beginEquations } from "./equations.js";
import { showSession } from "./sessions.js";
import { showHeld, showLibraries } from "./question.js";

async function openTable(made) {
  await trying("failure", async () => {
    const { table } = await made();
    Object.assign(state, { table, search: null, found: null, columns: {} });
    $("going").hidden = true;
    $("columns").open = false;
    remember();
    await recognise();
    showSession();
  });
}

export function openFile(file) {
  $("sample").value = "";
  return openTable(() => ask(`tables?name=${encodeURIComponent(file.name)}`, "POST", file));
}

export function openSample(name) {
  $("file").value = "";
  return openTable(() => ask("datasets", "POST", { name }));
}

export async function recognise() {
  state.preview = await ask("previews", "POST", { table: state.table, columns: state.columns });
  showPreview();
}

function showPreview() {
  const found = state.preview, roles = found.roles;
  $("table").hidden = false;
  tell($("problem"), found.problem);
  $("ask").hidden = Boolean(found.problem);
  $("guessed").hidden = !found.guessed || Boolean(state.columns.states?.length);
  $("guessed").firstElementChild.textContent = found.guessed || "";
  showColumns(found);
  showEdits();
  if (found.problem) {
    $("counts").textContent = found.name;
    $("columns").open = true;
    showChecks({ checks: [], notes: [] });
    return showMeasured();
  }
  $("counts").textContent = `${found.name}: ${plural(found.count, "trial")} of ${plural(found.objects.length, "object")}, ${plural(found.samples, "sample")}. States: ${roles.states.join(", ")}${roles.inputs.length ? `; inputs: ${roles.inputs.join(", ")}` : ""}.${found.trials.length < found.count ? ` The first ${found.trials.length} trials are drawn.` : ""}`;
  showChecks(found);
  showMeasured();
  $("explain_choice").hidden = !roles.properties.length;
  $("explain_names").textContent = roles.properties.join(", ");
  if (!roles.properties.length) $("explain").checked = false;
  showLibraries();
  showHeld();
  beginEquations();
}

function showChecks({ checks, notes, columns }) {
  for (const [id, what, items] of [["checks", "Data checks", checks.map(each => kindItem(each, columns))], ["notes", "How the table was read", notes.map(each => element("li", each))]]) {
    $(id).hidden = !items.length;
    $(id).firstElementChild.textContent = `${what} (${items.length})`;
    $(id).lastElementChild.replaceChildren(...items);
  }
}

/** What a check found in the same way: its text, and folded the cases with their rows. */
function kindItem({ text, count, cases }, columns) {
  const item = element("li", text), fold = element("details");
  if (!cases.some(each => each.rows.length)) return item;
  fold.append(element("summary", count > 1 ? "Cases and rows" : "The rows"));
  for (const each of cases) {
    if (count > 1) fold.append(element("p", each.text));
    fold.append(checkedRows(each, columns));
  }
  if (count > cases.length) fold.append(element("p", `and ${count - cases.length} more`));
  item.append(fold);
  return item;
}

function checkedRows({ text, rows, row, column }, columns) {
  const around = element("div", "", { class: "scroll", tabindex: 0, role: "region", "aria-label": `Rows: ${text}` }), table = element("table");
  table.append(element("thead"), element("tbody"));
  fill(table, ["row", ...columns], rows);
  const cell = row === null ? null : table.tBodies[0].rows[row].cells[columns.indexOf(column) + 1];
  if (cell) cell.replaceChildren(element("mark", cell.textContent || "empty"));
  around.append(table);
  return around;
}

/** The first rows, and above them what each column is: as the reader took it, or as it was chosen where the reader could not. */
function showColumns({ columns, rows, recognised }) {
  const table = $("columns").querySelector("table"), focused = document.activeElement.dataset?.column;
  fill(table, columns, rows);
  const choices = element("tr");
  for (const name of columns) {
    const cell = element("td"), choice = element("select", "", { "aria-label": `Role of ${name}`, "data-column": name });
    const roles = ["", "object", "trial", "time", "state", "input", "property", ...recognised.deviations?.includes(name) ? [DEVIATION] : []];
    for (const role of roles) choice.append(element("option", role || "not used", { value: role }));
    choice.value = roleOf(name, recognised);
    choice.addEventListener("change", () => takeColumns(choice));
    cell.append(choice);
    choices.append(cell);
  }
  table.tBodies[0].prepend(choices);
  $("is_wide").checked = Boolean(recognised.wide);
  $("wide_part").hidden = !recognised.wide;
  $("wide").value = recognised.wide || "";
  $("below").value = (state.columns.below ?? []).map(pair => pair.join("=")).join("; ");
  $("restarts").checked = Boolean(state.columns.restarts);
  $("missing").value = (state.columns.missing ?? []).join("; ");
  for (const id of ["decimal", "dates"]) $(id).value = state.columns[id] ?? "";
  if (focused) choices.querySelector(`[data-column="${CSS.escape(focused)}"]`)?.focus();
}

const DEVIATION = "standard deviation";
const SINGLE = ["object", "trial", "time"], SEVERAL = { state: "states", input: "inputs", property: "properties", [DEVIATION]: "deviations" };


function roleOf(name, roles) {
  return SINGLE.find(role => roles[role] === name) ?? Object.keys(SEVERAL).find(role => roles[SEVERAL[role]]?.includes(name)) ?? "";
}

/** Limits of quantification by the marks of values below them. */
function limits() {
  const pairs = $("below").value.split(";").map(each => each.split("=").map(part => part.trim())).filter(([mark]) => mark);
  return pairs.filter(([, limit]) => limit && Number.isFinite(Number(limit))).map(([mark, limit]) => [mark, Number(limit)]);
}

/** Take what was chosen: of the roles that one column has, the last choice takes it from another. */
export async function takeColumns(last) {
  const selects = [...$("columns").querySelectorAll("select")];
  if (SINGLE.includes(last?.value)) for (const each of selects) if (each !== last && each.value === last.value) each.value = "";
  const all = role => selects.filter(({ value }) => value === role).map(each => each.dataset.column);
  // What the reader took for labels is none where the user chose so
  const label = role => all(role)[0] ?? (state.columns[role] === "" || state.preview.recognised[role] ? "" : null);
  const { edits = [] } = state.columns;
  Object.assign(state, { found: null, search: null });
  state.columns = { object: label("object"), trial: label("trial"), time: all("time")[0] ?? null, states: all("state"), inputs: all("input"), properties: all("property") };
  const wide = $("is_wide").checked ? $("wide").value.trim() || "value" : null;
  Object.assign(state.columns, { wide, edits, below: limits(), restarts: $("restarts").checked ? "trials" : null });
  Object.assign(state.columns, { missing: $("missing").value.split(";").map(mark => mark.trim()).filter(Boolean), decimal: $("decimal").value || null, dates: $("dates").value || null });
  await trying("failure", recognise);
}
