const USUAL_SAMPLES = 60_000;

/** Return the usual duration of a closed loop. */
export const usualDuration = data =>
  Number(Math.min((data.horizon ?? 1) * 10, USUAL_SAMPLES / data.rate).toPrecision(1));

/** Return the power of ten by which runs are played faster, so that none takes hours. */
export function pace(data) {
  const tens = Math.log10(usualDuration(data) / 10);
  return Math.abs(tens) <= 1 ? 1 : 10 ** Math.round(tens);
}
