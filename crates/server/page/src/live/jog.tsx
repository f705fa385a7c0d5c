// A pad to hold: the view goes that way on the screen.

import { useEffect } from "preact/hooks";
import { moves, useMayHold } from "../act.ts";
import { use } from "../store.ts";
import { hold, release, releaseAll, type Way } from "./hold.ts";

const PAD: [string, string, Way][] = [
  ["up", "▲", { y: -1 }],
  ["left", "◀", { x: -1 }],
  ["right", "▶", { x: 1 }],
  ["down", "▼", { y: 1 }],
  ["turn left", "↺", { rz: -1 }],
  ["turn right", "↻", { rz: 1 }],
  ["focus away", "z+", { z: 1 }],
  ["focus nearer", "z−", { z: -0.5 }],
];

export function JogPad() {
  const may = useMayHold();
  const instrument = use((m) => m.instrument);
  useEffect(() => releaseAll, []);
  return (
    <section>
      <h2>
        Move <span class="soft">hold</span>
      </h2>
      <div class="pad">
        {PAD.filter(([, , way]) => moves(instrument, way)).map(([name, sign, way]) => (
          <button
            key={name}
            type="button"
            class={name.replace(" ", "-")}
            disabled={!may}
            aria-label={`${sign.startsWith("z") ? `${sign} ` : ""}${name}, hold`}
            onPointerDown={(event) => {
              if (event.button !== 0) return;
              event.currentTarget.setPointerCapture(event.pointerId);
              hold(name, way);
            }}
            onPointerUp={() => release(name)}
            onPointerCancel={() => release(name)}
            onLostPointerCapture={() => release(name)}
            onKeyDown={(event) => {
              if (!event.repeat && (event.key === " " || event.key === "Enter")) hold(name, way);
            }}
            onKeyUp={() => release(name)}
            onBlur={() => release(name)}
            onContextMenu={(event) => event.preventDefault()}
          >
            {sign}
          </button>
        ))}
      </div>
    </section>
  );
}
