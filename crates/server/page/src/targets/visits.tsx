// Whenever somebody came back to a saved view, and what it looked like then: any two beside each other.

import { useState } from "preact/hooks";
import { address } from "../api.ts";
import { moment } from "../format.ts";
import type { Run, Target } from "../types.ts";
import { More } from "../parts/more.tsx";
import { Slider } from "../run/compare.tsx";
import { Row } from "../run/runs.tsx";
import { useRuns } from "./list.ts";
import { words } from "../words.ts";

/** The saved view itself, where a run could be named. */
const SAVED = "";

export function Visits({ target }: { target: Target }) {
  const { rows, more, next } = useRuns(target.name);
  const all = rows?.filter((run) => run.job === "reposition");
  const seen = (all ?? []).filter((run) => run.arrival);
  return (
    <>
      <h3>Visits</h3>
      {all?.length === 0 && !more && <p class="soft">Nobody came back to it yet.</p>}
      {seen.length > 0 && <Beside target={target} seen={seen} />}
      {all?.map((run) => (
        <Row key={run.id} run={run} />
      ))}
      {more && <More shown={all?.length ?? 0} onMore={next} />}
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
