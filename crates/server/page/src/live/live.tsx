import { useState } from "preact/hooks";
import { attempt } from "../api.ts";
import { start } from "../act.ts";
import { refresh } from "../heard.ts";
import { use } from "../store.ts";
import { RunCard } from "../run/card.tsx";
import type { Histogram } from "./histogram.ts";
import { Panel } from "./panel.tsx";
import { View } from "./view.tsx";

export function Live() {
  const [bins, setBins] = useState<Histogram | null>(null);
  return (
    <main class="live">
      <View onHistogram={setBins} />
      <RunCard />
      <Left />
      <Panel bins={bins} />
    </main>
  );
}

/** A job that a program left when it was killed. */
function Left() {
  const left = use((m) => m.instrument?.left ?? null);
  const may = use((m) => m.me?.may_move ?? false);
  const busy = use((m) => m.state?.jobs.some((job) => job.state.state !== "ended") ?? false);
  if (!left || busy) return null;
  return (
    <section class="card left">
      <h2>Something was under way</h2>
      <p>{left}</p>
      {may && (
        <div class="row">
          <button type="button" class="primary" onClick={() => void start({ job: "resume" })}>
            Go on
          </button>
          <button type="button" onClick={() => void attempt("POST", "abandon").then(refresh)}>
            Abandon it
          </button>
        </div>
      )}
    </section>
  );
}
