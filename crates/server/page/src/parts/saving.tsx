// A name for the view that is saved: suggested, so that Enter is enough.

import { useEffect, useState } from "preact/hooks";
import { save } from "../act.ts";
import { ask } from "../api.ts";
import { freeName } from "../format.ts";
import { get, set, use } from "../store.ts";
import type { Target } from "../types.ts";
import { Dialog } from "./dialog.tsx";

export function Saving() {
  const shown = use((m) => m.saving);
  return shown ? <Form /> : null;
}

function Form() {
  const slide = use((m) => m.state?.slide ?? null);
  const stem = (slide ?? "view").replace(/[^A-Za-z0-9_.-]+/g, "-");
  const [name, setName] = useState(() => freeName(stem, get().targets.map((t) => t.name)));
  // Also beside those that are not at hand: names of this stem, unless somebody has written another meanwhile.
  useEffect(() => {
    void ask<Target[]>("GET", `targets?limit=500&text=${encodeURIComponent(stem)}`).then(
      (like) => setName((now) => (now === freeName(stem, get().targets.map((t) => t.name)) ? freeName(stem, [...like, ...get().targets].map((t) => t.name)) : now)),
      () => undefined,
    );
  }, []);
  const [focus, setFocus] = useState(true);
  const close = () => set({ saving: false });
  return (
    <Dialog title="Save this view" onClose={close}>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void save(name.trim(), focus);
        }}
      >
        <label>
          Name
          <input autofocus value={name} required pattern="[A-Za-z0-9_\-.]+" title="letters, digits, - _ and ." onInput={(e) => setName(e.currentTarget.value)} onFocus={(e) => e.currentTarget.select()} />
        </label>
        <label class="check">
          <input type="checkbox" checked={focus} onChange={(e) => setFocus(e.currentTarget.checked)} /> focus first
        </label>
        <p class="soft">The stage makes a small step aside and back, to see what belongs to the specimen and what is dust.</p>
        <div class="row end">
          <button type="button" onClick={close}>
            Cancel
          </button>
          <button type="submit" class="primary">
            Save
          </button>
        </div>
      </form>
    </Dialog>
  );
}
