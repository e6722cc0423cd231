import uPlot from "../../vendor/uPlot.esm.js";
import { tickText, timeUnit } from "../dom/text.js";
import { longest, ordered } from "../state/tracks.js";

const HEIGHTS = { state: 96, told: 68, input: 68, cost: 82 };
const STRIP = 14, FOOT = 24, LEFT = 58, RIGHT = 20;
/** Pixels beside the last time for each further letter of its unit. */
const WIDER = 4;
const FONT = "11px system-ui, sans-serif";
/** Pieces of a curve whose least and greatest samples are drawn. */
const PIECES = 600;
/** Most values of an input that are all ticks. */
const FEW = 3;

/** Return the data of a row's plot for uPlot: the times, and what each track has there. */
export function plotData(row, app) {
  if (row.paint) return [[0, longest(app.tracks)], ...app.tracks.map(() => [0, 0])];
  return uPlot.join(ordered(app).map(track => {
    const value = k => row.value(track, k), kept = extremes(track.t.length, value, PIECES);
    const shown = kept.map(value);
    return [kept.map(k => track.t[k]), shown.map(v => (Number.isFinite(v) ? v : null))];
  }));
}

/** Return the options of a row's plot for uPlot; the last has the times under it. */
export function plotOptions(row, app, key, width, last) {
  const strip = row.kind === "symbols";
  const height = strip ? 10 + STRIP * app.tracks.length : HEIGHTS[row.kind];
  const times = () => [0, longest(app.tracks) || 1];
  const right = RIGHT + WIDER * (timeUnit(app.data).length - 1);
  return {
    width, height: height + (last ? FOOT : 0), padding: [strip ? 6 : 17, right, strip ? 2 : 0, 0],
    legend: { show: false },
    cursor: { sync: { key, scales: ["x", null] }, drag: { x: false, y: false }, y: false,
      points: { show: false } },
    scales: { x: { time: false, range: times }, y: { range: rangeOf(row) } },
    axes: axesOf(row, app, last),
    series: [{}, ...ordered(app).map(track => ({
      stroke: app.theme.track(track.color), width: track === app.active ? 1.8 : 1.2,
      points: { show: false }, spanGaps: true,
      ...(row.paint ? { paths: () => null } : {}),
      ...(row.kind === "told" ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}),
    }))],
    hooks: { draw: row.paint ? [row.paint] : [] },
  };
}

function axesOf(row, { data, theme }, last) {
  const unit = timeUnit(data);
  const common = {
    stroke: theme.quiet, font: FONT,
    grid: { stroke: theme.faint, width: 1 }, ticks: { stroke: theme.faint, width: 1, size: 4 },
  };
  const across = {
    ...common, show: true, size: last ? FOOT : 4, space: 70, gap: 3,
    values: last ? (_, ticks) => ticks.map(v => `${tickText(ticks)(v)} ${unit}`) : () => [],
  };
  if (row.kind === "symbols") {
    const none = { show: false };
    return [across, { show: true, size: LEFT, grid: none, ticks: none, values: () => [] }];
  }
  const { values } = row;
  const few = values && (values.length <= FEW ? values : [values[0], values.at(-1)]);
  return [across, {
    ...common, size: LEFT, space: 22, gap: 4, values: (_, ticks) => ticks.map(tickText(ticks)),
    ...(few ? { splits: () => few } : {}),
  }];
}

function rangeOf(row) {
  if (row.kind === "symbols") return () => [0, 1];
  return (_, low, high) => {
    if (row.all) [low, high] = [Math.min(...row.all), Math.max(...row.all)];
    if (low === null) return [0, 1];
    const pad = (high - low || Math.abs(high) || 1) * (row.all ? 0.25 : 0.08);
    return [low - pad, high + pad];
  };
}

/** Return samples of a curve of `count` that keep its least and greatest value in every piece. */
function extremes(count, value, pieces) {
  const kept = [], each = Math.max(1, count / pieces);
  if (each <= 3) return Array.from({ length: count }, (_, k) => k);
  for (let start = 0; start < count; start += each) {
    const from = Math.floor(start), to = Math.min(count, Math.floor(start + each));
    let [low, high] = [from, from];
    for (let k = from + 1; k < to; k++) {
      const here = value(k);
      if (here < value(low)) low = k;
      if (here > value(high)) high = k;
    }
    kept.push(...[...new Set([from, low, high])].sort((a, b) => a - b));
  }
  if (kept.at(-1) !== count - 1) kept.push(count - 1);
  return kept;
}
