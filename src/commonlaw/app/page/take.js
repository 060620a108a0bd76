// 6. What to take away.
import { $, element, plural, state } from "./basics.js";

const FILES = {
  "report.html": "the report, one page with everything", "law.json": "the law, to open again", "coefficients.csv": "the coefficients",
  "forecasts.csv": "measured and forecast states, with bands", "law.svg": "the law and its forecasts as a figure", "law.tex": "the equations in LaTeX",
  "law.py": "a Python program that finds it again",
};

/** Offer the files of the candidate that is shown; only for the law that was chosen there is a program that finds it. */
export function showFiles() {
  const { chosen, size } = state.found.candidates[state.at], names = Object.keys(FILES).filter(name => chosen || name !== "law.py");
  $("taken").textContent = `Of the ${chosen ? "law that was chosen" : "candidate that is shown above"} (${plural(size, "term")}):`;
  $("files").replaceChildren(...names.map(name => {
    const line = element("li");
    const link = element("a", name, { href: `searches/${state.search}/${name}?candidate=${state.at}`, download: name });
    link.addEventListener("click", take);
    line.append(link, `: ${FILES[name]}`);
    return line;
  }));
}

/** The command that finds the law; there is none for a law that was opened. */
export function showCommand() {
  $("again").hidden = Boolean(state.asked.law);
  $("command").textContent = command();
}

/** Save a file once it is made, and say how far that is: a report takes a while. */
async function take(event) {
  const { href, download } = event.currentTarget;
  event.preventDefault();
  $("taking").textContent = `Making ${download} ...`;
  try {
    const answer = await fetch(href);
    if (!answer.ok) throw new Error((await answer.json()).error);
    const made = URL.createObjectURL(await answer.blob());
    element("a", "", { href: made, download }).click();
    setTimeout(() => URL.revokeObjectURL(made), 60000);
    $("taking").textContent = `${download} is in your downloads.`;
  } catch (error) {
    $("taking").textContent = `${download} could not be made: ${error.message}`;
  }
}

function command() {
  const quoted = text => /^[\w.:=,+-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
  const { preview, asked } = state, said = ["commonlaw", "discover", preview.name];
  const columns = asked.columns;
  for (const role of ["object", "trial", "time"]) if (columns[role]) said.push(`--${role}`, columns[role]);
  for (const [option, role] of [["--state", "states"], ["--input", "inputs"], ["--property", "properties"]]) for (const name of columns[role] ?? []) said.push(option, name);
  said.push("--order", String(asked.order), "--library", asked.library);
  for (const [name, value] of Object.entries(asked.known)) said.push("--known", `${name}=${value}`);
  const { kind, value } = asked.hold_out;
  if (kind === "after") said.push("--learn-until", value);
  else if (kind !== "nothing") said.push("--hold-out", `${preview.roles[kind]}=${value}`);
  if (asked.explain) said.push("--explain");
  return said.map(quoted).join(" ");
}

