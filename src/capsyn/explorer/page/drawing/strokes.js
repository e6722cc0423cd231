/** Draw a line through points. */
export function stroke(context, color, width, ...points) {
  context.beginPath();
  points.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.strokeStyle = color;
  context.lineWidth = width;
  context.lineCap = "round";
  context.lineJoin = "round";
  context.stroke();
}

/** Draw a disc. */
export function disc(context, color, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = color;
  context.fill();
}

/** Draw an arrow along the horizontal; none where it is too short. */
export function arrow(context, color, x, y, length) {
  if (Math.abs(length) < 2) return;
  const tip = x + length, back = Math.sign(length) * 6;
  stroke(context, color, 2.5, [x, y], [tip, y]);
  stroke(context, color, 2.5, [tip - back, y - 5], [tip, y], [tip - back, y + 5]);
}
