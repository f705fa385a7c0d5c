// What was done, the newest first.

import { address } from "../api.ts";
import { duration, moment, spaced, withUnits } from "../format.ts";
import { More } from "../parts/more.tsx";
import { useRuns } from "../targets/list.ts";
import type { Run } from "../types.ts";
import { words } from "../words.ts";

export function Runs() {
  const { rows, more, next } = useRuns();
  return (
    <main class="sheet" tabIndex={0}>
      <h1>Runs</h1>
      {rows?.length === 0 && <p class="soft">{words.noRuns}</p>}
      <ul class="runs">
        {rows?.map((run) => (
          <li key={run.id}>
            <Row run={run} />
          </li>
        ))}
      </ul>
      {more && <More shown={rows?.length ?? 0} onMore={next} />}
    </main>
  );
}

export function Row({ run }: { run: Run }) {
  const verdict = run.verdict ? (words.verdicts[run.verdict] ?? spaced(run.verdict)) : run.ended ? "done" : "not ended";
  const tone = run.verdict === "arrived" ? "good" : run.verdict ? "unsure" : "";
  return (
    <article class="one">
      <div class="row">
        <strong>
          {spaced(run.job)} {run.target}
        </strong>
        <span class={`tag ${tone}`}>{verdict}</span>
        <span class="grow" />
        <time class="soft">{moment(run.began)}</time>
      </div>
      {run.message && <p>{withUnits(run.message)}</p>}
      <p class="soft">
        {[run.slide && `slide ${run.slide}`, run.user && `by ${run.user}`, run.seconds !== null && duration(run.seconds)].filter(Boolean).join(" · ")}
        {run.report && (
          <>
            {" · "}
            <a target="_blank" rel="noreferrer" href={address(`runs/${encodeURIComponent(run.id)}/report.html`)}>
              report
            </a>
          </>
        )}
      </p>
    </article>
  );
}
