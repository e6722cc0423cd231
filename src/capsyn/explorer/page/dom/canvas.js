/** Give a canvas the pixels of its box on the screen; return its size in CSS pixels, and scale. */
export function fit(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  return { width, height, scale };
}

/** Return the context of a cleared canvas, in CSS pixels. */
export function cleared(canvas, scale) {
  const context = canvas.getContext("2d");
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, canvas.width, canvas.height);
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return context;
}

export function stroke(context, color, width, ...points) {
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.strokeStyle = color;
  context.lineWidth = width;
  context.lineCap = "round";
  context.lineJoin = "round";
  context.stroke();
}

/** Draw a disc, with an edge if it has a width. */
export function disc(context, color, [x, y], radius, edge = color, width = 0) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = color;
  context.fill();
  if (!width) return;
  context.strokeStyle = edge;
  context.lineWidth = width;
  context.stroke();
}

/** Write text; `font` has its size, in pixels of the context, and its weight before. */
export function write(context, text, [x, y], color, font, align = "center", baseline = "middle") {
  context.fillStyle = color;
  context.font = `${font}px system-ui, sans-serif`;
  context.textAlign = align;
  context.textBaseline = baseline;
  context.fillText(text, x, y);
}

/** Write text with a halo that sets it off; see `write`. */
export function writeOver(context, text, at, { ink, halo }, font, align) {
  context.lineJoin = "round";
  context.lineWidth = 4;
  context.strokeStyle = halo;
  write(context, "", at, ink, font, align);
  context.strokeText(text, ...at);
  context.fillText(text, ...at);
}

/** Draw an arrow along the horizontal; none where it is too short. */
export function arrow(context, color, x, y, length) {
  if (Math.abs(length) < 2) return;
  const tip = x + length, back = Math.sign(length) * 6;
  stroke(context, color, 2.5, [x, y], [tip, y]);
  stroke(context, color, 2.5, [tip - back, y - 5], [tip, y], [tip - back, y + 5]);
}
