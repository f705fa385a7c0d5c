// The specimen: a canvas that is drawn anew with each frame, and what is drawn over it.

import { useEffect, useRef, useState } from "preact/hooks";
import { by, mayPoint, mayStep, start, useMayPoint } from "../act.ts";
import { age, fineStep, length } from "../format.ts";
import { apply, ellipse, inverse, isAway, outline, promisedMiddle, scaleBar } from "../geometry.ts";
import { paintWith } from "../socket.ts";
import { get, use, useNow } from "../store.ts";
import type { Step } from "../run/trace.ts";
import type { FrameHead } from "../types.ts";
import { words } from "../words.ts";
import { histogram, type Histogram } from "./histogram.ts";

/** A press that moves by less is a click, pixels of the screen. */
const CLICK = 5;

/** Turns of the wheel are gathered for so long, ms, and so many at the most. */
const WHEEL_MS = 250;
const NOTCHES = 10;

export function View({ onHistogram }: { onHistogram: (bins: Histogram) => void }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const pressed = useRef<[number, number] | null>(null);
  const [drag, setDrag] = useState<[number, number]>([0, 0]);
  useEffect(() => {
    let frames = 0;
    paintWith((picture, head) => {
      const paper = canvas.current;
      if (!paper) return;
      if (paper.width !== picture.width || paper.height !== picture.height) {
        paper.width = picture.width;
        paper.height = picture.height;
      }
      const pen = paper.getContext("2d", { willReadFrequently: true });
      pen?.drawImage(picture, 0, 0);
      paper.dataset.seq = String(head.seq);
      if (pen && frames++ % 6 === 0) onHistogram(histogram(pen.getImageData(0, 0, paper.width, paper.height).data));
    });
    return () => paintWith(null);
  }, []);

  /** A place of the screen as shares of the image; null beside it. */
  const share = (x: number, y: number): [number, number] | null => {
    const paper = canvas.current;
    if (!paper) return null;
    const box = paper.getBoundingClientRect();
    const scale = Math.min(box.width / paper.width, box.height / paper.height);
    const [w, h] = [paper.width * scale, paper.height * scale];
    const u = (x - box.left - (box.width - w) / 2) / w;
    const v = (y - box.top - (box.height - h) / 2) / h;
    return u >= 0 && u <= 1 && v >= 0 && v <= 1 ? [u, v] : null;
  };

  const release = (event: PointerEvent) => {
    const from = pressed.current;
    pressed.current = null;
    setDrag([0, 0]);
    if (!from || !mayPoint()) return;
    const moved = Math.hypot(event.clientX - from[0], event.clientY - from[1]);
    if (moved < CLICK) {
      const place = share(event.clientX, event.clientY);
      if (place) void start({ job: "centre", x: place[0], y: place[1] });
      return;
    }
    // What was taken hold of comes along: the middle goes the other way.
    const [a, b] = [share(from[0], from[1]), share(event.clientX, event.clientY)];
    if (!a || !b) return;
    const inside = (v: number) => Math.min(1, Math.max(0, v));
    void start({ job: "centre", x: inside(0.5 - (b[0] - a[0])), y: inside(0.5 - (b[1] - a[1])) });
  };

  useWheel(canvas);
  const may = useMayPoint();

  return (
    <div class="view">
      <canvas
        ref={canvas}
        class={may ? "paper" : "paper watched"}
        role="img"
        aria-label="The specimen, live"
        style={{ translate: `${drag[0]}px ${drag[1]}px` }}
        onPointerDown={(event) => {
          if (event.button !== 0 || !mayPoint()) return;
          pressed.current = [event.clientX, event.clientY];
          event.currentTarget.setPointerCapture(event.pointerId);
        }}
        onPointerMove={(event) => {
          const from = pressed.current;
          if (from) setDrag([event.clientX - from[0], event.clientY - from[1]]);
        }}
        onPointerUp={release}
        onPointerCancel={() => {
          pressed.current = null;
          setDrag([0, 0]);
        }}
      />
      <Over />
      <Stale />
    </div>
  );
}

/** The wheel steps the focus: one notch, one fine step, upwards away from the specimen as the key Page up. What is turned while the stage moves is done in one step afterwards. */
function useWheel(canvas: { current: HTMLCanvasElement | null }): void {
  useEffect(() => {
    const paper = canvas.current;
    if (!paper) return;
    let notches = 0;
    let timer: number | null = null;
    const step = () => {
      timer = null;
      if (notches === 0) return;
      if (!mayStep()) {
        timer = window.setTimeout(step, WHEEL_MS);
        return;
      }
      const { state, instrument } = get();
      const um = instrument?.objectives.find((o) => o.id === state?.objective)?.um_per_px ?? 1;
      const nearer = instrument?.nearer_z ?? 0;
      if (nearer !== 0) by("z_um", -nearer * notches * fineStep(um));
      notches = 0;
      // Until the server has told that it moves.
      timer = window.setTimeout(step, WHEEL_MS);
    };
    const turn = (event: WheelEvent) => {
      event.preventDefault();
      if (event.deltaY === 0 || (notches === 0 && !mayStep() && timer === null)) return;
      notches = Math.max(-NOTCHES, Math.min(NOTCHES, notches - Math.sign(event.deltaY)));
      timer ??= window.setTimeout(step, 0);
    };
    paper.addEventListener("wheel", turn, { passive: false });
    return () => {
      paper.removeEventListener("wheel", turn);
      if (timer !== null) clearTimeout(timer);
    };
  }, []);
}

/** What is drawn over the image: its middle, a scale, and where the saved view lies in it. */
function Over() {
  const frame = use((m) => m.frame);
  if (!frame) return <p class="waiting">{words.opening}</p>;
  const { full_width: w, full_height: h } = frame;
  const bar = scaleBar(frame.um_per_px, w);
  return (
    <svg class="over" viewBox={`0 0 ${w} ${h}`} preserveAspectRatio="xMidYMid meet" aria-hidden="true">
      <path class="cross" d={`M${w / 2 - w / 40} ${h / 2}h${w / 20}M${w / 2} ${h / 2 - w / 40}v${w / 20}`} />
      <Found frame={frame} />
      {bar && (
        <g class="bar" transform={`translate(${w / 40} ${h - h / 30})`}>
          <path d={`M0 0h${bar.px}`} />
          <text x={bar.px / 2} y={-h / 60} font-size={w / 40} stroke-width={w / 220}>
            {length(bar.um).replace(".0 ", " ").replace(".00 ", " ")}
          </text>
        </g>
      )}
    </svg>
  );
}

/** The saved view where it was found: solid while the stage stands where it was seen from, dashed once it has moved since. */
function Found({ frame }: { frame: FrameHead }) {
  const step = use((m) => m.trace.steps.at(-1) ?? null);
  const isUnderWay = use((m) => m.state?.jobs[0]?.kind === "reposition" && m.state.jobs[0].state.state !== "ended");
  const size = use((m) => m.targets.find((t) => t.name === m.chosen) ?? (m.chosenTarget?.name === m.chosen ? m.chosenTarget : null));
  if (!step || !isUnderWay || step.objective !== frame.objective) return null;
  const corners = outline(step.targetFromView, size?.width ?? frame.full_width, size?.height ?? frame.full_height);
  if (!corners) return null;
  return (
    <g class={`found${step.converged ? " sure" : ""}${step.seenFrom && frame.at && isAway(step.seenFrom, frame.at) ? " since" : ""}`}>
      <polygon points={corners.map((c) => c.join(",")).join(" ")} />
      <Middles step={step} frame={frame} size={[size?.width ?? frame.full_width, size?.height ?? frame.full_height]} />
      {step.pairs.slice(0, 150).map((pair, k) => (
        <circle key={k} class="match" cx={pair[0]} cy={pair[1]} r={frame.full_width / 300} />
      ))}
    </g>
  );
}

/** Deviations that an ellipse is drawn at: hardly anything lies beyond. */
const SIGMAS = 3;

/** The middle of the saved view: filled where it is seen, hollow where the move before was to bring it, each with an ellipse for its doubt. */
function Middles({ step, frame, size }: { step: Step; frame: FrameHead; size: [number, number] }) {
  const wanted = use((m) => m.instrument?.objectives.find((o) => o.id === m.trace.wanted)?.um_per_px ?? null);
  const viewFromTarget = inverse(step.targetFromView);
  if (!viewFromTarget) return null;
  const seen = apply(viewFromTarget, [(size[0] - 1) / 2, (size[1] - 1) / 2]);
  const doubt = ellipse(step.targetFromView, SIGMAS * step.sigmaPx);
  const own = [(frame.full_width - 1) / 2, (frame.full_height - 1) / 2] as [number, number];
  const um = step.promised && wanted ? step.promised.um.map((v) => v / wanted) : null;
  const promised = um && promisedMiddle(step.targetFromView, um as [number, number], own);
  const open = step.promised && wanted ? ellipse(step.targetFromView, (SIGMAS * step.promised.sigmaUm) / wanted) : null;
  const r = frame.full_width / 110;
  return (
    <>
      {promised && open && (
        <g class="promised" transform={`translate(${promised[0]} ${promised[1]})`}>
          <ellipse class="doubt" rx={open.rx} ry={open.ry} transform={`rotate(${open.deg})`} />
          <circle r={r} />
        </g>
      )}
      {doubt && (
        <g class="seen" transform={`translate(${seen[0]} ${seen[1]})`}>
          <ellipse class="doubt" rx={doubt.rx} ry={doubt.ry} transform={`rotate(${doubt.deg})`} />
          <circle r={0.6 * r} />
        </g>
      )}
    </>
  );
}

/** A picture that is not live says so across itself. */
function Stale() {
  const now = useNow();
  const frameAt = use((m) => m.frameAt);
  const link = use((m) => m.link);
  if (frameAt === 0) return null;
  const seconds = (now - frameAt) / 1000;
  if (seconds < 2 && link !== "lost") return null;
  return (
    <p class="stale">
      {words.stale}
      {seconds >= 2 && `, ${age(seconds)}`}
    </p>
  );
}
