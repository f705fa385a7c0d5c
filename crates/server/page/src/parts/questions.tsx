// What the instrument asks people.

import { attempt } from "../api.ts";
import { stop } from "../act.ts";
import { use } from "../store.ts";
import { Dialog } from "./dialog.tsx";

export function Questions() {
  const question = use((m) => m.questions[0] ?? null);
  const may = use((m) => m.me?.may_move ?? false);
  if (!question || !may) return null;
  const answer = (yes: boolean) => void attempt("POST", `questions/${question.id}`, { yes });
  return (
    <Dialog title="The instrument asks" alert key={question.id} onClose={stop}>
      <p>{question.text}</p>
      <div class="row end">
        <button type="button" onClick={() => answer(false)}>
          No
        </button>
        <button type="button" class="primary" onClick={() => answer(true)}>
          Yes
        </button>
      </div>
    </Dialog>
  );
}
