// What was taken out, and may be taken back.

import { useState } from "preact/hooks";
import { purge, restore } from "../act.ts";
import { moment } from "../format.ts";
import { use } from "../store.ts";
import { Dialog } from "../parts/dialog.tsx";
import { More } from "../parts/more.tsx";
import { useBin } from "./list.ts";
import { words } from "../words.ts";

export function Bin({ onClose }: { onClose: () => void }) {
  const admin = use((m) => m.me?.role === "admin");
  const { rows, more, next } = useBin();
  const [sure, setSure] = useState<string | null>(null);
  return (
    <Dialog title="Bin" onClose={onClose}>
      {rows?.length === 0 && <p class="soft">Nothing lies in it.</p>}
      <ul class="plain">
        {rows?.map((target) => (
          <li key={target.number} class="row">
            <span>{target.name}</span>
            <span class="soft">
              {[target.slide && `slide ${target.slide}`, `saved ${moment(target.saved)}`, target.binned && `taken out ${moment(target.binned)}`].filter(Boolean).join(" · ")}
            </span>
            <span class="grow" />
            <button type="button" onClick={() => void restore(target.name)}>
              Take back
            </button>
            {admin &&
              (sure === target.name ? (
                <button
                  type="button"
                  class="danger"
                  onClick={() => {
                    setSure(null);
                    void purge(target.name);
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
      {more && <More shown={rows?.length ?? 0} onMore={next} />}
      {sure && <p class="bad">{words.purge}</p>}
      <div class="row end">
        <button type="button" class="primary" autofocus onClick={onClose}>
          Close
        </button>
      </div>
    </Dialog>
  );
}
