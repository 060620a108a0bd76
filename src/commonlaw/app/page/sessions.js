// Sessions: a table, its question and its law, saved by a name, continued after a restart, and taken back a state.
import { $, ask, element, reach, remember, state, trying } from "./basics.js";
import { recognise } from "./measurements.js";
import { showQuestion, showSearch } from "./question.js";

/** Offer the sessions that were saved. */
export async function offerSessions() {
  const sessions = await ask("sessions");
  $("resume").hidden = !sessions.length;
  $("saved_sessions").replaceChildren(...sessions.map(({ key, name, table, saved, problem }) => element("option", `${name} (${problem ? "cannot be opened" : `${table}, ${saved.slice(0, 16).replace("T", " ")}`})`, { value: key })));
}

/** Show which session this is; none after another table was opened. */
export function showSession(session = null) {
  state.session = session;
  $("session_name").value = session?.name ?? state.preview?.name?.replace(/\.\w+$/, "") ?? "";
  $("session_undo").hidden = !(session?.states > 1);
  $("session_said").textContent = "";
}

/** Save the session: by its name, or once it has been saved whenever something changes. */
export async function saveSession() {
  await trying("session_failed", async () => {
    const { table, columns, search, session } = state, name = $("session_name").value;
    const renamed = session && session.name !== name.trim();
    const saved = await ask("sessions", "POST", { name, table, columns, search: search ?? null, key: renamed ? null : session?.key ?? null });
    if (state.table !== table) return;
    showSession(saved);
    $("session_said").textContent = `Saved at ${new Date(saved.saved).toLocaleTimeString()}.`;
    await offerSessions();
  });
}

export async function saveAgain() {
  if (state.session) await saveSession();
}

/** Go on with a session as it was. */
async function show({ table, search, columns, session }) {
  Object.assign(state, { table, search, columns, found: null, written: null });
  remember();
  await recognise();
  showSession(session);
  if (!search) return;
  showQuestion(await ask(`searches/${search}/question`));
  await trying("failed", showSearch);
}

export async function openSession() {
  await trying("failure", async () => show(await ask(`sessions/${$("saved_sessions").value}`, "POST")));
}

export async function undoSession() {
  await trying("session_failed", async () => show(await ask(`sessions/${state.session.key}/undo`, "POST")));
}

/** Delete a session; until another is deleted it can be brought back. */
export async function deleteSession() {
  const key = $("saved_sessions").value;
  await trying("failure", async () => {
    await ask(`sessions/${key}`, "DELETE");
    if (state.session?.key === key) showSession();
    $("session_restore").hidden = false;
    $("session_restore").onclick = async () => {
      await ask(`sessions/${key}/restored`, "POST");
      $("session_restore").hidden = true;
      await offerSessions();
    };
    await offerSessions();
  });
}

/** Copy the coefficients as a table, tabs between its cells, as spreadsheets take it. */
export async function copyCoefficients() {
  $("copied").textContent = "";
  await trying("copied", async () => {
    const answer = await reach(`searches/${state.search}/coefficients.tsv?candidate=${state.at}`);
    await navigator.clipboard.writeText(await answer.text());
    $("copied").textContent = "Copied: paste into a spreadsheet.";
  });
}
