// The page: a table, a question, a law. All that a law needs is here once it was found; moving along candidates asks nobody.
import { $, ask, state, trying } from "./basics.js";
import { forecastOwn, showCurves } from "./curves.js";
import { move } from "./law.js";
import { drawPreview, openFile, openSample, recognise } from "./measurements.js";
import { showHeld, showLibraries, showSearch, start } from "./question.js";

const drop = $("drop");
for (const name of ["dragover", "dragleave", "drop"]) {
  drop.addEventListener(name, event => { event.preventDefault(); drop.classList.toggle("over", name === "dragover"); });
}
drop.addEventListener("drop", event => event.dataTransfer.files[0] && openFile(event.dataTransfer.files[0]));
$("file").addEventListener("change", () => $("file").files[0] && openFile($("file").files[0]));
$("sample").addEventListener("change", () => $("sample").value && openSample($("sample").value));
$("preview_state").addEventListener("change", drawPreview);
$("order").addEventListener("change", showLibraries);
$("hold_out").addEventListener("change", showHeld);
$("start").addEventListener("click", () => start());
$("back").addEventListener("click", () => move(0));
$("slider").addEventListener("input", () => move(state.order[Number($("slider").value)]));
$("state").addEventListener("change", showCurves);
$("trials").addEventListener("change", showCurves);
for (const [id, checked] of [["none", false], ["all", true]]) {
  $(id).addEventListener("click", () => { for (const box of $("trials").querySelectorAll("input")) box.checked = checked; showCurves(); });
}
for (const id of ["own_object", "duration"]) $(id).addEventListener("change", forecastOwn);
$("saved").addEventListener("change", async () => $("saved").files[0] && start(await $("saved").files[0].text()));

// Coming back after a reload, or with a table that the command named
const kept = new URLSearchParams(location.hash.slice(1));
await trying("failure", async () => {
  state.table = kept.get("table") ?? (await ask("first")).table;
  if (!state.table) return;
  await recognise();
  state.search = kept.get("search");
  if (state.search) await trying("failed", showSearch);
});
