// The time line of a recorded run that is played: play, pause, seek. A live run has none.

import { command } from "./connection.js";
import { byId, setText } from "./dom.js";

let dragged = false, asking = 0;

/** Let the controls ask the player. */
export function offerPlayer() {
  const slider = byId("place");
  slider.addEventListener("pointerdown", () => (dragged = true));
  slider.addEventListener("input", () => setText(byId("place-text"), minutes(Number(slider.value))));
  slider.addEventListener("change", async () => {
    asking += 1;
    await ask({ action: "seek", at_s: Number(slider.value) });
    asking -= 1;
    dragged = asking > 0;
  });
  for (const end of ["pointerup", "pointercancel"]) slider.addEventListener(end, () => setTimeout(() => (dragged = asking > 0)));
  byId("play").addEventListener("click", () => ask({ action: byId("play").dataset.playing === "yes" ? "pause" : "play" }));
}

/** Show where the player is. */
export function showPlayer(line) {
  byId("player").hidden = !line;
  if (!line || dragged) return;
  const slider = byId("place");
  slider.max = String(line.end_s);
  slider.value = String(line.at_s);
  setText(byId("place-text"), `${minutes(line.at_s)} of ${minutes(line.end_s)}`);
  byId("play").dataset.playing = line.playing ? "yes" : "no";
  setText(byId("play"), line.playing ? "Stop playing" : "Play");
}

async function ask(content) {
  try {
    await command(content);
  } catch (error) {
    setText(byId("place-text"), error.message);
  }
}

function minutes(seconds) {
  const whole = Math.floor(seconds / 60), rest = (seconds - 60 * whole).toFixed(1).padStart(4, "0");
  return `${whole}:${rest}`;
}
