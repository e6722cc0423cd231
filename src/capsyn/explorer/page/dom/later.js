/** Return a function that does something once before the next frame, however often it is asked. */
export function makeSoon() {
  const waiting = new Set();
  return (name, action) => {
    if (waiting.has(name)) return;
    waiting.add(name);
    requestAnimationFrame(() => {
      waiting.delete(name);
      action();
    });
  };
}

/** Return a function that shows text in an element for a time [ms]. */
export function makeNote(element, time) {
  let timer = null;
  return text => {
    clearTimeout(timer);
    element.textContent = text;
    timer = setTimeout(() => (element.textContent = ""), time);
  };
}
