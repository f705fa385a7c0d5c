// Steps of a run: each a dot at its error on a logarithmic scale, with its doubt as a bar.

import { length } from "../format.ts";
import { get } from "../store.ts";
import type { Step } from "./trace.ts";

const LEAST_UM = 0.05;
const MOST_UM = 2000;

function height(um: number): number {
  const bounded = Math.min(MOST_UM, Math.max(LEAST_UM, um));
  return 58 - (54 * Math.log(bounded / LEAST_UM)) / Math.log(MOST_UM / LEAST_UM);
}

export function Steps({ steps }: { steps: Step[] }) {
  if (steps.length === 0) return null;
  const objectives = get().instrument?.objectives ?? [];
  const wide = Math.max(6, steps.length);
  const x = (k: number) => 16 + ((k + 0.5) * 82) / wide;
  return (
    <svg class="steps" viewBox="0 0 100 62" role="img" aria-label={`steps so far: ${steps.map((s) => length(s.errorUm)).join(", ")}`}>
      {[0.1, 1, 10, 100, 1000].map((um) => (
        <g key={um} class="line">
          <path d={`M15 ${height(um)}H99`} />
          <text x="13" y={height(um) + 1.3}>
            {um >= 1000 ? "1 mm" : `${um} µm`}
          </text>
        </g>
      ))}
      {steps.map((step, k) => {
        const um = objectives.find((o) => o.id === step.objective)?.um_per_px ?? 1;
        const sigma = step.sigmaPx * um;
        return (
          <g key={`${step.objective}-${step.sequence}`} class={step.converged ? "step sure" : "step"}>
            <path d={`M${x(k)} ${height(step.errorUm + sigma)}V${height(Math.max(LEAST_UM, step.errorUm - sigma))}`} />
            <circle cx={x(k)} cy={height(step.errorUm)} r="1.7" />
            <title>{`${step.objective}: ${length(step.errorUm)} ± ${length(sigma)}`}</title>
          </g>
        );
      })}
    </svg>
  );
}
