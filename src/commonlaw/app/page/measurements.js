// 1. Measurements: a table, what its columns are, what is odd about it.
import { $, ask, element, fill, labels, plural, remember, state, trying, withUnit } from "./basics.js";
import { draw } from "./plots.js";
import { showHeld, showLibraries } from "./question.js";

export async function openTable(made) {
  await trying("failure", async () => {
    const { table } = await made();
    Object.assign(state, { table, search: null, found: null, columns: {} });
    $("result").hidden = $("going").hidden = true;
    remember();
    await recognise();
  });
}

export const openFile = file => openTable(() => ask(`tables?name=${encodeURIComponent(file.name)}`, "POST", file));

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
    return draw($("preview_plot"), [], {});
  }
  $("counts").textContent = `${found.name}: ${plural(found.count, "trial")} of ${plural(found.objects.length, "object")}, ${plural(found.samples, "sample")}; states ${roles.states.join(", ")}`;
  $("odd").hidden = !found.odd.length;
  $("odd").firstElementChild.textContent = `What is odd (${found.odd.length})`;
  $("odd").lastElementChild.replaceChildren(...found.odd.map(each => element("li", each)));
  const names = labels(found.trials);
  const curves = found.trials.map((trial, i) => ({ t: trial.t, line: trial.states[0], points: trial.states[0], label: names[i], color: i }));
  draw($("preview_plot"), curves, { x: withUnit({ name: roles.time, unit: found.units[roles.time] }), y: withUnit({ name: roles.states[0], unit: found.units[roles.states[0]] }), height: 220 });
  showLibraries();
  showHeld();
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
