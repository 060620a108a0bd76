// The page: a table, a question, a law. All that a law needs is here once it was found; moving along candidates asks nobody.
import { $, ask, remember, state, trying } from "./basics.js";
import { compare, compareGroups, offerReferences } from "./compare.js";
import { choose, drawFigure } from "./figures.js";
import { changeView, showCurves, togetherOrAlone } from "./curves.js";
import { exclude, subtractBlanks, toggleMouse, undo } from "./edits.js";
import { close, complete, fit, read, showValues, startFrom, steer, takeGiven } from "./equations.js";
import { move } from "./law.js";
import { openFile, openSample, recognise, takeColumns } from "./measurements.js";
import { showBudget, suggest } from "./next.js";
import { forecastOwn } from "./own.js";
import { findPanels } from "./panels.js";
import { makeSettings, showHeld, showLibraries, showQuestion, showSearch, start } from "./question.js";
import { copyCoefficients, deleteSession, offerSessions, openSession, saveSession, showSession, undoSession } from "./sessions.js";
import { take } from "./take.js";

const drop = $("drop");
for (const name of ["dragover", "dragleave", "drop"]) {
  drop.addEventListener(name, event => { event.preventDefault(); drop.classList.toggle("over", name === "dragover"); });
}
drop.addEventListener("drop", event => event.dataTransfer.files[0] && openFile(event.dataTransfer.files[0]));
$("file").addEventListener("change", () => $("file").files[0] && openFile($("file").files[0]));
$("sample").addEventListener("change", () => $("sample").value && openSample($("sample").value));
$("confirm").addEventListener("click", () => takeColumns());
$("change").addEventListener("click", () => { $("columns").open = true; $("columns").querySelector("select[data-column]").focus(); });
for (const id of ["is_wide", "wide", "below", "restarts", "missing", "decimal", "dates"]) $(id).addEventListener("change", () => takeColumns());
$("order").addEventListener("change", showLibraries);
$("hold_out").addEventListener("change", showHeld);
$("start").addEventListener("click", () => start());
$("back").addEventListener("click", () => move(0));
$("slider").addEventListener("input", () => move(state.order[Number($("slider").value)]));
$("state").addEventListener("change", showCurves);
$("view").addEventListener("change", changeView);
$("find").addEventListener("input", findPanels);
$("all").addEventListener("click", togetherOrAlone);
$("exclude").addEventListener("click", exclude);
$("subtract").addEventListener("click", subtractBlanks);
$("exclude_mouse").addEventListener("click", toggleMouse);
for (const id of ["undo", "undo_see"]) $(id).addEventListener("click", undo);
addEventListener("keydown", event => {
  const typing = event.target.matches("input, textarea, select");
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !typing && state.columns.edits?.length) { event.preventDefault(); undo(); }
});
$("log").addEventListener("change", showCurves);
for (const id of ["starts_given", "initial_time"]) $(id).addEventListener("change", takeGiven);
for (const id of ["figure", "figure_object", "figure_parameter"]) $(id).addEventListener("change", choose);
$("draw").addEventListener("click", drawFigure);
for (const [id, work] of [["session_open", openSession], ["session_save", saveSession], ["session_delete", deleteSession], ["session_undo", undoSession], ["copy", copyCoefficients]]) $(id).addEventListener("click", work);
$("rival").addEventListener("change", compare);
$("groups_part").addEventListener("toggle", compareGroups);
$("groups_by").addEventListener("change", () => { offerReferences(); compareGroups(); });
$("groups_reference").addEventListener("change", compareGroups);
$("write_from").addEventListener("change", startFrom);
$("write_object").addEventListener("change", showValues);
$("equations").addEventListener("input", () => { complete(); read(); });
$("equations").addEventListener("keydown", steer);
$("equations").addEventListener("blur", close);
$("fit").addEventListener("click", fit);
for (const id of ["svg", "png"]) $(id).addEventListener("click", take);
for (const id of ["own_object", "duration"]) $(id).addEventListener("change", forecastOwn);
$("next_budget").addEventListener("input", showBudget);
$("next_suggest").addEventListener("click", suggest);
$("saved").addEventListener("change", async () => $("saved").files[0] && start({ law: await $("saved").files[0].text() }));

// Coming back after a reload, or in another window; or with a table that the command named
const kept = new URLSearchParams(location.hash.slice(1)), last = kept.size ? Object.fromEntries(kept) : await ask("first");
await trying("failure", async () => {
  await makeSettings();
  await offerSessions();
  if (state.table) return;  // A file was opened meanwhile
  Object.assign(state, { table: last.table ?? null, search: last.search ?? null });
  const asked = state.search && await ask(`searches/${state.search}/question`);
  if (asked) Object.assign(state, { table: asked.table, columns: asked.columns });
  if (!state.table) return;
  await recognise();
  showSession();
  remember();
  if (!asked) return;
  showQuestion(asked);
  await trying("failed", showSearch);
});
