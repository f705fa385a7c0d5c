// What was taken out, and may be taken back.

import { useEffect, useState } from "preact/hooks";
import { bin, purge, restore } from "../act.ts";
import { moment } from "../format.ts";
import { use } from "../store.ts";
import type { Target } from "../types.ts";
import { Dialog } from "../parts/dialog.tsx";
import { words } from "../words.ts";

export function Bin({ onClose }: { onClose: () => void }) {
  const admin = use((m) => m.me?.role === "admin");
  const [all, setAll] = useState<Target[] | null>(null);
  const [sure, setSure] = useState<string | null>(null);
  const look = () => void bin().then(setAll);
  useEffect(look, []);
  return (
    <Dialog title="Bin" onClose={onClose}>
      {all?.length === 0 && <p class="soft">Nothing lies in it.</p>}
      <ul class="plain">
        {all?.map((target) => (
          <li key={`${target.name} ${target.binned}`} class="row">
            <span>{target.name}</span>
            <span class="soft">
              {[target.slide && `slide ${target.slide}`, `saved ${moment(target.saved)}`, target.binned && `taken out ${moment(target.binned)}`].filter(Boolean).join(" · ")}
            </span>
            <span class="grow" />
            <button type="button" onClick={() => void restore(target.name).then(look)}>
              Take back
            </button>
            {admin &&
              (sure === target.name ? (
                <button
                  type="button"
                  class="danger"
                  onClick={() => {
                    setSure(null);
                    void purge(target.name).then(look);
                  }}
                >
                  Yes, delete it for good
                </button>
              ) : (
                <button type="button" onClick={() => setSure(target.name)}>
                  Delete …
                </button>
              ))}
          </li>
        ))}
      </ul>
      {sure && <p class="bad">{words.purge}</p>}
      <div class="row end">
        <button type="button" class="primary" autofocus onClick={onClose}>
          Close
        </button>
      </div>
    </Dialog>
  );
}
