import { makeMapTools as makePlainTools } from "../../controls/map_tools.js";
import { byId, element, labelled } from "../../dom/elements.js";
import { DEFAULT } from "../../policy/symbols.js";
import { look } from "../../state/changes.js";

const ANY = "any";

/** Return the tools over the map, see the other `makeMapTools`, with the symbol in force. */
export function makeMapTools(app) {
  const tools = makePlainTools(app), { data, lookup } = app;
  if (!lookup.remembers) return tools;
  const symbols = data.memory.in_force.filter(label => label < data.symbols.length - 1);
  const option = (value, text) => element("option", { value }, text);
  const picker = element("select", {
    id: "in-force", title: "The symbol for which the map shows what follows it; of any, stripes " +
      "show all that may follow",
    onchange: () => look(app, () => {
      lookup.shown = picker.value === ANY ? null : Number(picker.value);
    }),
  }, option(ANY, "any: stripes"), symbols.map(k => option(k, data.symbols[k])),
  option(DEFAULT, "none yet"));
  byId("zoom").before(labelled("in force", picker));

  function sync() {
    tools.sync();
    picker.value = String(lookup.shown ?? ANY);
  }

  return { ...tools, sync };
}
