import { byId } from "../dom/elements.js";
import { look } from "../state/changes.js";

/** Listen to the keys of the page, and to the buttons of its head. */
export function listenToKeys(app) {
  const { data, theme, view, parts: { bar, tools } } = app, help = byId("help");
  byId("theme").addEventListener("click", () => theme.toggle());
  byId("keys").addEventListener("click", () => help.showModal());
  const keys = {
    " ": () => bar?.toggle(), r: () => bar?.rewind(), d: () => theme.toggle(),
    o: () => look(app, () => (view.outlines = !view.outlines)),
    p: () => data.proved && look(app, () => (view.proved = !view.proved)),
    "[": () => tools.show(view.level - 1), "]": () => tools.show(view.level + 1),
    "?": () => help.showModal(),
  };
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || help.open) return;
    const own = event.target.closest("input, select, button, textarea");
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    if (own && (event.key === " " || own.type === "number" || own.tagName === "SELECT")) return;
    event.preventDefault();
    action();
  });
}
