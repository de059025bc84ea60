// Calls whoever switched it on when a run ends, holds or is lost: a sound, and a notice of the browser where it shows one.
import { live } from "./live.js";
import { runTitle } from "./names.js";
import { news } from "./news.js";
import { remembered } from "./store.js";
import { t } from "./words.js";

/** Whether this browser calls. */
export const calling = remembered("calling", false);
const TONE_HZ = 880;
const TONE_S = 0.6;

/** Switch calls on or off; the browser asks once whether it may show notices. */
export function call(on) {
  calling.set(on);
  if (!on) return;
  sound();
  if ("Notification" in globalThis) Notification.requestPermission();
}

function sound() {
  const audio = new AudioContext();
  const tone = audio.createOscillator();
  const loudness = audio.createGain();
  tone.frequency.value = TONE_HZ;
  loudness.gain.setValueAtTime(0.2, audio.currentTime);
  loudness.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + TONE_S);
  tone.connect(loudness).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + TONE_S);
  tone.onended = () => audio.close();
}

let before = live.get();
live.subscribe((now) => {
  const found = news(before, now);
  before = now;
  if (!calling.get() || !found.length) return;
  sound();
  if (globalThis.Notification?.permission !== "granted") return;
  for (const { run, what } of found) {
    try {
      new Notification(t(`call.${what}`, { run: `${run.split("/")[0]} ${runTitle(run)}` }), { tag: run });
    } catch {
      // A browser of a telephone shows none of a page: the sound has called.
    }
  }
});
