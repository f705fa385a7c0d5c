// Focus, light and place, at the edge of the view; on a phone a sheet.

import { useState } from "preact/hooks";
import { attempt } from "../api.ts";
import { by, start, useDrives, useMayStart, useMayStep } from "../act.ts";
import { age, fineStep, fixed } from "../format.ts";
import { use, useNow } from "../store.ts";
import type { Histogram } from "./histogram.ts";
import { JogPad } from "./jog.tsx";

export function Panel({ bins }: { bins: Histogram | null }) {
  const [open, setOpen] = useState(false);
  const may = use((m) => m.me?.may_move ?? false);
  return (
    <aside class={open ? "panel open" : "panel"} aria-label="Controls" tabIndex={0}>
      <button type="button" class="handle" aria-expanded={open} onClick={() => setOpen(!open)}>
        {open ? "Hide controls" : "Controls"}
      </button>
      <div class="inside">
        <Focus may={may} />
        <Light may={may} bins={bins} />
        {may && <JogPad />}
        <Where />
        {may && <Care />}
      </div>
    </aside>
  );
}

function Focus({ may }: { may: boolean }) {
  const all = use((m) => m.sharpness);
  const um = use((m) => m.instrument?.objectives.find((o) => o.id === m.state?.objective)?.um_per_px ?? 1);
  const busy = !useMayStep();
  const mayStart = useMayStart();
  const nearer = use((m) => m.instrument?.nearer_z ?? 0);
  const most = Math.max(1e-9, ...all);
  const points = all.map((v, k) => `${(k * 100) / 89},${30 - (28 * v) / most}`).join(" ");
  const fine = fineStep(um);
  return (
    <section>
      <h2>Focus</h2>
      <svg class="spark" viewBox="0 0 100 32" preserveAspectRatio="none" role="img" aria-label={`sharpness now ${fixed((100 * (all.at(-1) ?? 0)) / most, 0)} percent of the best of the last seconds`}>
        <polyline points={points} />
      </svg>
      {may && (
        <div class="row">
          <button type="button" disabled={busy || nearer === 0} onClick={() => by("z_um", fine * nearer)}>
            {fine} µm nearer
          </button>
          <button type="button" disabled={busy || nearer === 0} onClick={() => by("z_um", -fine * nearer)}>
            {fine} µm away
          </button>
          <button type="button" disabled={!mayStart} onClick={() => void start({ job: "focus" })}>
            Focus <kbd>F</kbd>
          </button>
        </div>
      )}
    </section>
  );
}

function Light({ may, bins }: { may: boolean; bins: Histogram | null }) {
  const exposure = use((m) => m.state?.exposure_ms ?? null);
  const light = use((m) => m.state?.light ?? null);
  const saturated = use((m) => m.frame?.saturated ?? 0);
  const dark = use((m) => m.frame?.dark ?? 0);
  const drives = useDrives();
  const set = (ms: number) => void attempt("POST", "exposure", { ms });
  return (
    <section>
      <h2>Light</h2>
      {bins && <Bins bins={bins} />}
      {saturated > 0.01 && <p class="unsure">{fixed(100 * saturated, 0)} % of the image is too bright to show anything</p>}
      {dark > 0.5 && <p class="soft">most of the image is black</p>}
      {exposure !== null && (
        <div class="row">
          <span class="value">{fixed(exposure, exposure < 10 ? 1 : 0)} ms</span>
          {may && (
            <>
              <button type="button" disabled={!drives} aria-label="expose shorter" onClick={() => set(exposure / 1.25)}>
                −
              </button>
              <button type="button" disabled={!drives} aria-label="expose longer" onClick={() => set(exposure * 1.25)}>
                +
              </button>
            </>
          )}
        </div>
      )}
      {light !== null && (
        <div class="row">
          <span class="value">lamp {fixed(100 * light, 0)} %</span>
          {may && (
            <>
              <button type="button" disabled={!drives} aria-label="less light" onClick={() => void attempt("POST", "light", { level: Math.max(0, light - 0.05) })}>
                −
              </button>
              <button type="button" disabled={!drives} aria-label="more light" onClick={() => void attempt("POST", "light", { level: Math.min(1, light + 0.05) })}>
                +
              </button>
            </>
          )}
        </div>
      )}
    </section>
  );
}

function Bins({ bins }: { bins: Histogram }) {
  const most = Math.max(1e-9, ...bins);
  const d = bins.map((n, k) => `M${k + 0.5} 30V${30 - 29 * Math.sqrt(n / most)}`).join("");
  return (
    <svg class="bins" viewBox="0 0 64 30" preserveAspectRatio="none" role="img" aria-label="histogram of the image">
      <path d={d} />
    </svg>
  );
}

function Where() {
  const now = useNow();
  const at = use((m) => m.state?.at ?? null);
  const seen = use((m) => m.stateAt - 1000 * (m.state?.at_age_s ?? 0));
  const homed = use((m) => m.state?.homed ?? true);
  const moving = use((m) => m.state?.moving ?? false);
  const may = use((m) => m.me?.may_move ?? false);
  const busy = !useMayStep();
  const old = moving ? 0 : (now - seen) / 1000 - 1;
  return (
    <section class={old >= 2 ? "where old" : "where"}>
      <h2>Stage {moving && <span class="soft">moves</span>}</h2>
      {at && (
        <dl class="place">
          {at.x_um !== undefined && <Axis name="x" value={fixed(at.x_um, 1)} unit="µm" />}
          {at.y_um !== undefined && <Axis name="y" value={fixed(at.y_um, 1)} unit="µm" />}
          {at.z_um !== undefined && <Axis name="z" value={fixed(at.z_um, 1)} unit="µm" />}
          {at.rz_deg !== undefined && <Axis name="turned" value={fixed(at.rz_deg, 2)} unit="°" />}
        </dl>
      )}
      {old >= 2 && <p class="bad">{age(old)}</p>}
      {!homed && (
        <>
          <p class="bad">The stage does not know where it is.</p>
          {may && (
            <button type="button" disabled={busy} onClick={() => void start({ job: "home" })}>
              Let it find its reference: it may move anything anywhere
            </button>
          )}
        </>
      )}
    </section>
  );
}

function Axis({ name, value, unit }: { name: string; value: string; unit: string }) {
  return (
    <div>
      <dt>{name}</dt>
      <dd>
        {value} <span class="soft">{unit}</span>
      </dd>
    </div>
  );
}

/** What an instrument needs now and then. */
function Care() {
  const busy = !useMayStart();
  const none = use((m) => m.instrument?.objectives.every((o) => !o.calibrated) ?? true);
  return (
    <section>
      <h2>Instrument</h2>
      <div class="row">
        <button type="button" disabled={busy} title="measures how the camera sees the stage, objective by objective, over tissue" onClick={() => void start({ job: "calibrate" })}>
          Calibrate
        </button>
        <button type="button" disabled={busy || none} title="two small moves with each objective tell whether its calibration holds" onClick={() => void start({ job: "check" })}>
          Check
        </button>
        <button type="button" disabled={busy} title="looks through the devices; nothing moves" onClick={() => void start({ job: "doctor" })}>
          Doctor
        </button>
      </div>
    </section>
  );
}
