// Next experiment: suggestions for up to three purposes, for a budget of trials.
import { $, ask, element, plural, state, trying } from "./basics.js";

export function showNext() {
  $("next").hidden = false;
  $("next_found").replaceChildren();
  $("next_failed").textContent = "";
  showBudget();
}

export function showBudget() {
  $("next_budget_text").textContent = plural(Number($("next_budget").value), "trial");
}

export async function suggest() {
  $("next_suggest").disabled = true;
  $("next_going").textContent = "Looking for experiments ...";
  await trying("next_failed", async () => {
    const { suggestions } = await ask(`searches/${state.search}/experiments`, "POST", { trials: Number($("next_budget").value) });
    $("next_found").replaceChildren(...suggestions.flatMap(({ purpose, experiments, trials, settles }) => {
      const list = element("ol");
      list.append(...experiments.map(each => element("li", each)));
      return [element("h3", `${purpose}: ${plural(trials, "trial")}`), list, ...settles.map(each => element("p", each))];
    }));
  });
  $("next_going").textContent = "";
  $("next_suggest").disabled = false;
}
