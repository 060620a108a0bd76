// 1. Measurements: a table, what its columns are, what is odd about it.
import { $, ask, element, fill, labels, plural, remember, state, trying, withUnit } from "./basics.js";
import { draw } from "./plots.js";
import { showHeld, showLibraries } from "./question.js";

async function openTable(made) {
  await trying("failure", async () => {
    const { table } = await made();
    Object.assign(state, { table, search: null, found: null, columns: {} });
    $("result").hidden = $("going").hidden = true;
    $("columns").open = false;
    remember();
    await recognise();
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
  $("problem").textContent = found.problem;
  $("ask").hidden = Boolean(found.problem);
  showColumns(found);
  if (found.problem) {
    $("counts").textContent = found.name;
    $("columns").open = true;
    $("preview_states").hidden = true;
    showOddities({ odd: [], notes: [] });
    return draw($("preview_plot"), [], {});
  }
  $("counts").textContent = `${found.name}: ${plural(found.count, "trial")} of ${plural(found.objects.length, "object")}, ${plural(found.samples, "sample")}. Measured: ${roles.states.join(", ")}${roles.inputs.length ? `; acting from outside: ${roles.inputs.join(", ")}` : ""}.${found.trials.length < found.count ? ` The first ${found.trials.length} trials are drawn.` : ""}`;
  showOddities(found);
  $("preview_states").hidden = roles.states.length < 2;
  $("preview_state").replaceChildren(...roles.states.map((name, j) => element("option", name, { value: j })));
  drawPreview();
  $("explain_choice").hidden = !roles.properties.length;
  $("explain_names").textContent = roles.properties.join(", ");
  if (!roles.properties.length) $("explain").checked = false;
  showLibraries();
  showHeld();
}

export function drawPreview() {
  const { trials, roles, units } = state.preview, names = labels(trials), j = Number($("preview_state").value);
  const curves = trials.map((trial, i) => ({ t: trial.t, line: trial.states[j], points: trial.states[j], label: names[i], color: i }));
  const [x, y] = [roles.time, roles.states[j]].map(name => withUnit({ name, unit: units[name] }));
  draw($("preview_plot"), curves, { x, y, height: 220 });
}

function showOddities({ odd, notes, columns }) {
  for (const [id, what, items] of [["odd", "What is odd", odd.map(each => kindItem(each, columns))], ["notes", "How the table was read", notes.map(each => element("li", each))]]) {
    $(id).hidden = !items.length;
    $(id).firstElementChild.textContent = `${what} (${items.length})`;
    $(id).lastElementChild.replaceChildren(...items);
  }
}

/** What is odd in the same way: its text, and folded the cases with their rows. */
function kindItem({ text, count, cases }, columns) {
  const item = element("li", text), fold = element("details");
  if (!cases.some(each => each.rows.length)) return item;
  fold.append(element("summary", count > 1 ? "The cases, with their rows" : "The rows"));
  for (const each of cases) {
    if (count > 1) fold.append(element("p", each.text));
    fold.append(oddRows(each, columns));
  }
  if (count > cases.length) fold.append(element("p", `and ${count - cases.length} more`));
  item.append(fold);
  return item;
}

function oddRows({ text, rows, row, column }, columns) {
  const around = element("div", "", { class: "scroll", tabindex: 0, role: "region", "aria-label": `Rows: ${text}` }), table = element("table");
  table.append(element("thead"), element("tbody"));
  fill(table, ["row", ...columns], rows);
  const cell = row === null ? null : table.tBodies[0].rows[row].cells[columns.indexOf(column) + 1];
  if (cell) cell.replaceChildren(element("mark", cell.textContent || "empty"));
  around.append(table);
  return around;
}

function showColumns({ columns, rows, roles }) {
  const table = $("columns").querySelector("table");
  fill(table, columns, rows);
  const choices = element("tr");
  for (const name of columns) {
    const cell = element("td"), choice = element("select", "", { "aria-label": `What ${name} is`, "data-column": name });
    for (const role of ["", "object", "trial", "time", "state", "input", "property"]) choice.append(element("option", role || "not used", { value: role }));
    choice.value = roleOf(name, roles ?? {});
    choice.addEventListener("change", setColumns);
    cell.append(choice);
    choices.append(cell);
  }
  table.tBodies[0].prepend(choices);
}

function roleOf(name, roles) {
  for (const role of ["object", "trial", "time"]) if (roles[role] === name) return role;
  if (roles.states?.includes(name)) return "state";
  if (roles.inputs?.includes(name)) return "input";
  return roles.properties?.includes(name) ? "property" : "";
}

async function setColumns() {
  const chosen = [...$("columns").querySelectorAll("select")].map(each => [each.dataset.column, each.value]);
  const all = role => chosen.filter(([, value]) => value === role).map(([name]) => name);
  state.columns = { object: all("object")[0] ?? null, trial: all("trial")[0] ?? null, time: all("time")[0] ?? null, states: all("state"), inputs: all("input"), properties: all("property") };
  await trying("failure", recognise);
}
