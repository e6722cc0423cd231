const MARGINS = {
  strip: { left: 16, right: 16, top: 12, bottom: 44 },
  plane: { left: 60, right: 14, top: 12, bottom: 44 },
};

/** Return where the plane of n states is on a canvas: {x, y, width, height} [CSS pixels]. */
export function framed({ width, height, scale }, n) {
  const margin = n > 1 ? MARGINS.plane : MARGINS.strip;
  const round = value => Math.round(value * scale) / scale;
  return {
    x: margin.left, y: margin.top,
    width: Math.max(20, round(width - margin.left - margin.right)),
    height: Math.max(20, round(height - margin.top - margin.bottom)),
  };
}

/** Return the pixels [x, y] of shares of the plane. */
export const toPixels = (frame, [across, up]) => [
  frame.x + across * frame.width, frame.y + (1 - up) * frame.height,
];

/** Return the shares of the plane of pixels. */
export const toShares = (frame, [x, y]) => [
  (x - frame.x) / frame.width, 1 - (y - frame.y) / frame.height,
];

/** Whether pixels are in the frame, or at its edge. */
export const within = (frame, [x, y]) => x >= frame.x - 1 && x <= frame.x + frame.width + 1 &&
  y >= frame.y - 1 && y <= frame.y + frame.height + 1;

export const isIn = shares => shares.every(share => share >= 0 && share <= 1);

/** Return the shares that are in the plane and nearest. */
export const nearest = shares => shares.map(share => Math.min(Math.max(share, 0), 1));
