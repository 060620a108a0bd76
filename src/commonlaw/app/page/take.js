// Files to take away, and the command that makes the law again.
import { $, element, plural, reach, state } from "./basics.js";

const FILES = {
  "report.html": "report with all results, one page, which a browser prints as PDF", "law.json": "law, to be opened again", "coefficients.csv": "coefficients with standard errors", "coefficients.xlsx": "the same for Excel",
  "fit.csv": "measured and fitted states, with bands", "forecasts.csv": "forecasts from the first samples, with bands", "law.svg": "figure of the law and its fit", "law.png": "the same figure as an image", "law.tex": "equations in LaTeX",
  "law.py": "Python program that reproduces the search",
};

/** Offer the files of the candidate that is shown, and its command; only for the law that was chosen there is a program that finds it. */
export function showFiles() {
  const { chosen, size } = state.found.candidates[state.at], names = Object.keys(FILES).filter(name => chosen || name !== "law.py");
  $("taken").textContent = `Files of the ${chosen ? "chosen law" : "candidate shown"} (${plural(size, "term")}):`;
  $("files").replaceChildren(...names.map(name => {
    const line = element("li");
    const link = element("a", name, { href: `searches/${state.search}/${name}?${new URLSearchParams({ candidate: state.at, ...name === "report.html" && state.session ? { title: state.session.name } : {} })}`, download: name });
    link.addEventListener("click", take);
    line.append(link, `: ${FILES[name]}`);
    return line;
  }));
  const said = command(state.found.candidates[state.at]);
  $("again").hidden = !said;
  $("command").textContent = said;
}

/** Save a file once it is made, and say how far that is: a report takes a while. */
export async function take(event) {
  const { href, download } = event.currentTarget;
  event.preventDefault();
  $("taking").textContent = `Making ${download} ...`;
  try {
    const answer = await reach(href);
    const made = URL.createObjectURL(await answer.blob());
    element("a", "", { href: made, download }).click();
    setTimeout(() => URL.revokeObjectURL(made), 60000);
    $("taking").textContent = `${download} is in your downloads.`;
  } catch (error) {
    $("taking").textContent = `${download} could not be made: ${error.message}`;
  }
}

/**
 * The command that finds the law, or fits the candidate that is shown. There is none for a law that was opened, and for a
 * candidate with known coefficients, which its equation does not say; nor for equations with priors.
 */
function command({ chosen, text }) {
  const { preview, asked, found } = state, { columns } = asked, known = Object.entries(asked.known);
  const { equations } = asked, given = chosen && equations;
  if (given && Object.keys(equations.priors).length) return "";
  if (asked.law || (!chosen && (known.length || !found.others))) return "";
  const roles = [], reading = [];
  // Excluded data have no option: the program law.py has them
  if (columns.edits?.length) return "";
  for (const [mark, limit] of columns.below ?? []) reading.push("--below", `${mark}=${limit}`);
  for (const role of ["object", "trial", "time"]) if (columns[role] || columns[role] === "") roles.push(`--${role}`, columns[role]);
  for (const [option, role] of [["--state", "states"], ["--input", "inputs"]]) for (const name of columns[role] ?? []) roles.push(option, name);
  for (const name of columns.properties ?? []) (chosen ? roles : reading).push("--property", name);
  for (const option of ["wide", "restarts", "decimal", "dates"]) if (columns[option]) reading.push(`--${option}`, columns[option]);
  for (const mark of columns.missing ?? []) reading.push("--missing", mark);
  const file = preview.name.replace(/^-/, "./-");  // No option
  const described = reading.length ? ["commonlaw", "data", "check", file, ...roles, ...reading, "--save", "schema.toml"] : [];
  const said = ["commonlaw", chosen && !given ? "discover" : "fit", file, ...given ? [asked.written.replace(/^-/, " -")] : chosen ? [] : [text.join("; ")]];
  said.push(...reading.length ? ["--schema", "schema.toml"] : roles);
  if (given) {
    for (const [name, value] of Object.entries(equations.starts)) said.push("--initial-value", `${name}=${value}`);
    if (equations.initial_time !== null) said.push("--initial-time", String(equations.initial_time));
    for (const name of equations.doses) said.push("--dose", name);
    for (const [name, by] of Object.entries(equations.shared)) said.push("--shared", by === "all" ? name : `${name}=${by}`);
  } else if (chosen) said.push("--order", String(asked.order), "--library", asked.library);
  for (const [name, value] of known) said.push("--known", `${name}=${value}`);
  for (const { name, of_fit } of state.settings) if ((chosen && !given) || of_fit) for (const value of asked.settings[name] ?? []) said.push("--set", `${name}=${value}`);
  const { kind, value } = asked.hold_out;
  if (kind === "after") said.push("--learn-until", value);
  else if (kind !== "nothing") said.push("--hold-out", `${preview.roles[kind]}=${value}`);
  if (chosen && !given && asked.explain) said.push("--explain");
  return [described, said].filter(words => words.length).map(words => words.map(quoted).join(" ")).join("\n");
}

/** A word of a command as a shell reads it. */
function quoted(text) {
  if (/^[\w.:=,+-]+$/.test(text)) return text;
  return /["$`\\!]/.test(text) ? `'${text.replaceAll("'", "'\\''")}'` : `"${text}"`;
}
