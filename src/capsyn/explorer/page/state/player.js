/**
 * Return a clock that plays from 0 to `length()`, `speed` a second: {time, playing, speed, play, pause,
 * seek}. It calls `moved()` when the time has changed, and when it starts or stops.
 */
export function makePlayer(length, moved) {
  const player = { time: 0, playing: false, speed: 1 };
  let before = null;

  function tick(now) {
    if (!player.playing) return;
    if (before !== null) player.time += ((now - before) / 1000) * player.speed;
    before = now;
    if (player.time >= length()) {
      player.time = length();
      player.playing = false;
    } else requestAnimationFrame(tick);
    moved();
  }

  player.play = () => {
    if (player.playing || !length()) return;
    if (player.time >= length()) player.time = 0;
    player.playing = true;
    before = null;
    requestAnimationFrame(tick);
    moved();
  };
  player.pause = () => {
    player.playing = false;
    moved();
  };
  player.seek = time => {
    player.time = Math.min(Math.max(time, 0), length());
    before = null;
    moved();
  };
  return player;
}
