// The edge above: which instrument, what lies on it, who drives, and how old it is.

import { attempt } from "../api.ts";
import { start, useMayStep } from "../act.ts";
import { age } from "../format.ts";
import { type Page, set, use, useNow } from "../store.ts";
import { words } from "../words.ts";
import { Who } from "../people/who.tsx";

export function Top() {
  const instrument = use((m) => m.instrument);
  return (
    <header class="top">
      <strong class="name">{instrument?.name ?? "scopeservo"}</strong>
      {instrument?.simulated && <span class="simulated">{words.simulated}</span>}
      <Slide />
      <Pages />
      <span class="grow" />
      <Driver />
      <ObjectiveChoice />
      <LiveDot />
      <Who />
      <button type="button" class="small" aria-label="Keys and help" onClick={() => set({ help: true })}>
        ?
      </button>
    </header>
  );
}

function Pages() {
  const page = use((m) => m.page);
  const isAdmin = use((m) => m.me?.role === "admin");
  const all: Page[] = isAdmin ? ["live", "targets", "runs", "people"] : ["live", "targets", "runs"];
  return (
    <nav class="pages" aria-label="Pages">
      {all.map((one) => (
        <button key={one} type="button" aria-current={page === one ? "page" : undefined} onClick={() => set({ page: one })}>
          {words.pages[one]}
        </button>
      ))}
    </nav>
  );
}

function Slide() {
  const slide = use((m) => m.state?.slide ?? "");
  const may = use((m) => m.me !== null && m.me !== undefined && m.me.role !== "viewer");
  return (
    <label class="slide">
      <span>slide</span>
      <input
        key={slide}
        defaultValue={slide}
        placeholder="name it"
        disabled={!may}
        size={8}
        onChange={(event) => void attempt("POST", "slide", { name: event.currentTarget.value || null })}
      />
    </label>
  );
}

function Driver() {
  const owner = use((m) => m.state?.owner ?? null);
  const mine = use((m) => m.state?.mine ?? false);
  const asked = use((m) => m.state?.asked_by ?? null);
  const may = use((m) => m.me?.may_move ?? false);
  const user = use((m) => m.me?.user ?? "");
  return (
    <span class="driver">
      {mine ? (
        <span>you drive</span>
      ) : owner === user && owner !== "" ? (
        <span>you drive, elsewhere</span>
      ) : owner ? (
        <span>{owner} drives</span>
      ) : (
        <span class="soft">nobody drives</span>
      )}
      {mine && asked && (
        <button type="button" class="small primary" onClick={() => void attempt("POST", "lease/give")}>
          hand over to {asked}
        </button>
      )}
      {mine && !asked && (
        <button type="button" class="small" onClick={() => void attempt("POST", "lease/give")}>
          let go
        </button>
      )}
      {may && !mine && owner && owner !== user && (
        <button type="button" class="small" onClick={() => void attempt("POST", "lease/ask")}>
          ask to drive
        </button>
      )}
    </span>
  );
}

function ObjectiveChoice() {
  const all = use((m) => m.instrument?.objectives ?? null);
  const now = use((m) => m.state?.objective ?? null);
  const may = useMayStep();
  if (!all) return null;
  return (
    <label class="objective">
      <span class="hidden">objective</span>
      <select disabled={!may || all.length < 2} value={now ?? ""} onChange={(e) => void start({ job: "objective", objective: e.currentTarget.value })}>
        {now === null && <option value="">unknown</option>}
        {all.map((o) => (
          <option key={o.id} value={o.id}>
            {o.id}
            {o.calibrated ? "" : " (not calibrated)"}
          </option>
        ))}
      </select>
    </label>
  );
}

function LiveDot() {
  const now = useNow();
  const frameAt = use((m) => m.frameAt);
  const link = use((m) => m.link);
  // Pictures come where they are looked at; elsewhere it is how things stand that is new or old.
  const isLooking = use((m) => m.page === "live");
  const stateAt = use((m) => m.stateAt);
  if (link !== "lost" && !isLooking && now - stateAt < 2000) return <span class="dot good">● connected</span>;
  if (link === "opening" || frameAt === 0) return <span class="dot soft">○ waiting</span>;
  const seconds = (now - (isLooking ? frameAt : stateAt)) / 1000;
  if (link === "lost") return <span class="dot bad">○ lost</span>;
  return seconds < 2 ? <span class="dot good">● {words.live}</span> : <span class="dot bad">○ {age(seconds)}</span>;
}
