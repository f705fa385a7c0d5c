// Whenever somebody came back to a saved view, and what it looked like then: any two beside each other.

import { useEffect, useState } from "preact/hooks";
import { address, ask } from "../api.ts";
import { moment } from "../format.ts";
import { use } from "../store.ts";
import type { Run, Target } from "../types.ts";
import { Slider } from "../run/compare.tsx";
import { Row } from "../run/runs.tsx";
import { words } from "../words.ts";

/** So many are told, and can be compared. */
const VISITS = 100;
const LISTED = 20;
/** The saved view itself, where a run could be named. */
const SAVED = "";

export function Visits({ target }: { target: Target }) {
  const revision = use((m) => m.state?.revision ?? 0);
  const [all, setAll] = useState<Run[] | null>(null);
  useEffect(() => {
    void ask<Run[]>("GET", `runs?limit=${VISITS}&target=${encodeURIComponent(target.name)}`).then(
      (runs) => setAll(runs.filter((run) => run.job === "reposition")),
      () => setAll([]),
    );
  }, [target.name, revision]);
  const seen = (all ?? []).filter((run) => run.arrival);
  return (
    <>
      <h3>Visits</h3>
      {all?.length === 0 && <p class="soft">Nobody came back to it yet.</p>}
      {seen.length > 0 && <Beside target={target} seen={seen} />}
      {(all ?? []).slice(0, LISTED).map((run) => (
        <Row key={run.id} run={run} />
      ))}
    </>
  );
}

function Beside({ target, seen }: { target: Target; seen: Run[] }) {
  const has = (id: string) => id === SAVED || seen.some((run) => run.id === id);
  const [left, setLeft] = useState(SAVED);
  const [right, setRight] = useState(seen[0]?.id ?? SAVED);
  // One that is gone is the saved view again.
  const ids = [left, right].map((id) => (has(id) ? id : SAVED)) as [string, string];
  const picture = (id: string) => address(id === SAVED ? `targets/${encodeURIComponent(target.name)}/image.png` : `runs/${encodeURIComponent(id)}/arrival.jpg`);
  const called = (id: string) => (id === SAVED ? `the saved view` : `the view of ${moment(seen.find((run) => run.id === id)?.began ?? "")}`);
  const choice = (label: string, id: string, choose: (id: string) => void) => (
    <label class="pick">
      <span class="soft">{label}</span>
      <select value={id} onChange={(e) => choose(e.currentTarget.value)}>
        <option value={SAVED}>saved {moment(target.saved)}</option>
        {seen.map((run) => (
          <option key={run.id} value={run.id}>
            {moment(run.began)}
            {run.user ? `, ${run.user}` : ""}
          </option>
        ))}
      </select>
    </label>
  );
  return (
    <section aria-label={words.beside}>
      <div class="row">
        {choice("left", ids[0], setLeft)}
        {choice("right", ids[1], setRight)}
      </div>
      <Slider left={picture(ids[0])} right={picture(ids[1])} alt={[called(ids[0]), called(ids[1])]} />
    </section>
  );
}
