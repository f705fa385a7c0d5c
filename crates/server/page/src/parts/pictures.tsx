// What lies under the demonstration's microscope: its own slide, or a picture that somebody brought.

import { useEffect, useState } from "preact/hooks";
import { layPicture, mayStart, useMayStart } from "../act.ts";
import { address, ask, attempt, Refused, send } from "../api.ts";
import { fixed, moment } from "../format.ts";
import { set, use } from "../store.ts";
import type { Picture } from "../types.ts";
import { words } from "../words.ts";
import { Dialog } from "./dialog.tsx";

/** What is taken, as files are called and as they are sent. */
const KINDS: Record<string, string> = { png: "image/png", jpg: "image/jpeg", jpeg: "image/jpeg", tif: "image/tiff", tiff: "image/tiff", jp2: "image/jp2" };

/** A name as the library takes them, by that of a file. */
export function nameOf(file: string): string {
  const stem = file.replace(/^.*[\\/]/, "").replace(/\.[^.]*$/, "");
  return stem.normalize("NFKD").replace(/[^A-Za-z0-9_.-]+/g, "-").replace(/^[-.]+|[-.]+$/g, "").slice(0, 60) || "picture";
}

export function Pictures({ onClose }: { onClose: () => void }) {
  const revision = use((m) => m.state?.revision ?? 0);
  const lies = use((m) => m.state?.demo?.picture ?? null);
  const free = useMayStart();
  const [all, setAll] = useState<Picture[] | null>(null);
  useEffect(() => {
    void ask<Picture[]>("GET", "pictures").then(setAll, () => setAll([]));
  }, [revision]);
  const lay = (name: string | null) => void (mayStart() && layPicture(name));
  return (
    <Dialog title="Another slide" onClose={onClose}>
      <ul class="plain">
        <li class="row">
          <span>the tissue of the demonstration</span>
          <span class="grow" />
          <Lay lies={lies === null} free={free} onLay={() => lay(null)} />
        </li>
        {all?.map((picture) => (
          <li key={picture.name} class="row">
            <span>{picture.name}</span>
            <span class="soft">
              {picture.size_px[0]} × {picture.size_px[1]} pixels of {fixed(picture.um_per_px, 2)} µm · {moment(picture.brought)}
            </span>
            <span class="grow" />
            {lies !== picture.name && (
              <button type="button" onClick={() => void attempt("DELETE", `pictures/${encodeURIComponent(picture.name)}`)}>
                Remove
              </button>
            )}
            <Lay lies={lies === picture.name} free={free} onLay={() => lay(picture.name)} />
          </li>
        ))}
      </ul>
      <Bring free={free} />
      <div class="row end">
        <button type="button" class="primary" autofocus onClick={onClose}>
          Close
        </button>
      </div>
    </Dialog>
  );
}

function Lay({ lies, free, onLay }: { lies: boolean; free: boolean; onLay: () => void }) {
  if (lies) return <span class="tag good">lies there</span>;
  return (
    <button type="button" disabled={!free} onClick={onLay}>
      Lay it there
    </button>
  );
}

/** A picture of one's own. */
function Bring({ free }: { free: boolean }) {
  const [file, setFile] = useState<File | null>(null);
  const [scale, setScale] = useState("0.5");
  const [comes, setComes] = useState(false);
  const um = Number(scale);
  const isScale = um >= 0.01 && um <= 50;
  const bring = async (file: File) => {
    const kind = KINDS[file.name.toLowerCase().split(".").at(-1) ?? ""];
    if (!kind) {
      set({ refused: { code: "not_a_picture", kind: "input", message: words.pictures } });
      return;
    }
    const name = nameOf(file.name);
    setComes(true);
    try {
      await send(address(`pictures/${encodeURIComponent(name)}?um_per_px=${um}`), kind, file);
      set({ refused: null });
      if (free && mayStart()) await layPicture(name);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      set({ refused: error.failure });
    } finally {
      setComes(false);
    }
  };
  return (
    <form
      class="row bring"
      onSubmit={(event) => {
        event.preventDefault();
        if (file) void bring(file);
      }}
    >
      <label class="grow">
        <span class="soft">a picture of your own</span>
        <input type="file" accept={Object.keys(KINDS).map((ending) => `.${ending}`).join(",")} onChange={(e) => setFile(e.currentTarget.files?.[0] ?? null)} />
      </label>
      <label>
        <span class="soft">µm per pixel</span>
        <input type="number" min="0.01" max="50" step="any" required value={scale} onInput={(e) => setScale(e.currentTarget.value)} />
      </label>
      <button type="submit" disabled={!file || !isScale || comes}>
        {comes ? "It is being sent …" : "Use it as the slide"}
      </button>
    </form>
  );
}
