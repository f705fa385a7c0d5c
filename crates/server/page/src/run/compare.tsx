// The saved view over the present one, with a slider between the two.

import { useEffect, useRef, useState } from "preact/hooks";
import { address } from "../api.ts";

/** Two pictures, one over the other, with a slider between them. */
export function Slider({ left, right, alt }: { left: string; right: string; alt: [string, string] }) {
  const [share, setShare] = useState(50);
  return (
    <figure class="compare">
      <div class="pair">
        <img class="under" alt={alt[1]} src={right} />
        <img alt={alt[0]} src={left} style={{ clipPath: `inset(0 ${100 - share}% 0 0)` }} />
        <span class="edge" style={{ left: `${share}%` }} />
      </div>
      <input type="range" min="0" max="100" value={share} aria-label={`between ${alt[0]} and ${alt[1]}`} onInput={(e) => setShare(Number(e.currentTarget.value))} />
      <figcaption>
        left {alt[0]}, right {alt[1]}
      </figcaption>
    </figure>
  );
}

export function Compare({ name }: { name: string }) {
  const now = useRef<HTMLCanvasElement>(null);
  const [share, setShare] = useState(50);
  // The view as it is when one begins to look: both stand still.
  useEffect(() => {
    const live = document.querySelector<HTMLCanvasElement>(".paper");
    const paper = now.current;
    if (!live || !paper) return;
    paper.width = live.width;
    paper.height = live.height;
    paper.getContext("2d")?.drawImage(live, 0, 0);
  }, []);
  return (
    <figure class="compare">
      <div class="pair">
        <canvas ref={now} aria-label="the view now" role="img" />
        <img alt="the saved view" src={address(`targets/${encodeURIComponent(name)}/image.png`)} style={{ clipPath: `inset(0 ${100 - share}% 0 0)` }} />
        <span class="edge" style={{ left: `${share}%` }} />
      </div>
      <input type="range" min="0" max="100" value={share} aria-label="between the saved view and the view now" onInput={(e) => setShare(Number(e.currentTarget.value))} />
      <figcaption>left the saved view, right the view now</figcaption>
    </figure>
  );
}
