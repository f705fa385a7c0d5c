// The edge below, on every page: three verbs, and what one may go back to.

import { useState } from "preact/hooks";
import { attempt } from "../api.ts";
import { goBack, stop, useMayStart, useWhyNot } from "../act.ts";
import { address } from "../api.ts";
import { withUnits } from "../format.ts";
import { set, use } from "../store.ts";
import { words } from "../words.ts";
import { Pictures } from "./pictures.tsx";

export function Bottom() {
  const may = use((m) => m.me?.may_move ?? false);
  const chosen = use((m) => m.chosen);
  const busy = !useMayStart();
  const demo = use((m) => m.state?.demo ?? null);
  const why = useWhyNot();
  const [pictures, setPictures] = useState(false);
  return (
    <footer class="bottom">
      {why && (
        <p class="whynot" role="status">
          {withUnits(why)}
        </p>
      )}
      {may && (
        <button type="button" class="verb" disabled={busy} onClick={() => set({ saving: true })}>
          {words.save} <kbd>S</kbd>
        </button>
      )}
      {may && (
        <button type="button" class="verb primary" disabled={busy || !chosen} onClick={() => void goBack(chosen)}>
          {words.back}
          {chosen && <span class="which">{chosen}</span>} <kbd>G</kbd>
        </button>
      )}
      <Recent />
      {may && demo && (
        <button type="button" class="verb quiet" disabled={busy} onClick={() => void attempt("POST", "demo", { slide: "move" })}>
          Take the slide out, put it back
        </button>
      )}
      {may && demo && (
        <button type="button" class="verb quiet" onClick={() => setPictures(true)}>
          Another slide …
        </button>
      )}
      {pictures && <Pictures onClose={() => setPictures(false)} />}
      <button type="button" class="verb stop" onClick={stop}>
        {words.stop} <kbd>Esc</kbd>
      </button>
    </footer>
  );
}

function Recent() {
  const targets = use((m) => m.targets);
  const chosen = use((m) => m.chosen);
  return (
    <ul class="recent" aria-label="Saved views">
      {targets.slice(0, 8).map((target) => (
        <li key={target.name}>
          <button type="button" aria-pressed={target.name === chosen} title={target.name} onClick={() => set({ chosen: target.name })}>
            <img alt={target.name} src={address(`targets/${encodeURIComponent(target.name)}/thumb.jpg`)} />
          </button>
        </li>
      ))}
    </ul>
  );
}
