// Saved views as a contact sheet.

import { useEffect, useState } from "preact/hooks";
import { address, ask } from "../api.ts";
import { edit, goBack, remove, removeAll, useMayStart } from "../act.ts";
import { length, moment } from "../format.ts";
import { scaleBar } from "../geometry.ts";
import { set, use } from "../store.ts";
import type { Target } from "../types.ts";
import { Dialog } from "../parts/dialog.tsx";
import { More } from "../parts/more.tsx";
import { Bin } from "./bin.tsx";
import { useTargets } from "./list.ts";
import { Visits } from "./visits.tsx";
import { words } from "../words.ts";

export function Targets() {
  const none = use((m) => m.targets.length === 0);
  const revision = use((m) => m.state?.revision ?? 0);
  const [text, setText] = useState("");
  const [quality, setQuality] = useState("");
  const [slide, setSlide] = useState("");
  const [slides, setSlides] = useState<string[]>([]);
  useEffect(() => {
    void ask<{ name: string; targets: number }[]>("GET", "slides").then(
      (all) => setSlides(all.filter((one) => one.targets > 0).map((one) => one.name)),
      () => undefined,
    );
  }, [revision]);
  const [open, setOpen] = useState<string | null>(null);
  const [bin, setBin] = useState(false);
  const list = useTargets({ text, slide, quality });
  const shown = list.rows ?? [];
  const one = shown.find((t) => t.name === open);
  const may = use((m) => m.me !== null && m.me !== undefined && m.me.role !== "viewer");
  const [marked, setMarked] = useState<Set<string>>(new Set());
  // Those that are gone, or are not shown, are not marked: nobody takes out what they do not see.
  const chosen = shown.filter((t) => marked.has(t.name)).map((t) => t.name);
  const mark = (name: string, is: boolean) => {
    const next = new Set(marked);
    if (is) next.add(name);
    else next.delete(name);
    setMarked(next);
  };
  return (
    <main class="sheet">
      <div class="row wide">
        <h1>Targets</h1>
        <span class="grow" />
        <label>
          <span class="hidden">search</span>
          <input type="search" placeholder="search" value={text} onInput={(e) => setText(e.currentTarget.value)} />
        </label>
        {slides.length > 0 && (
          <label>
            <span class="hidden">slide</span>
            <select value={slide} onChange={(e) => setSlide(e.currentTarget.value)}>
              <option value="">any slide</option>
              {slides.map((one) => (
                <option key={one}>{one}</option>
              ))}
            </select>
          </label>
        )}
        <label>
          <span class="hidden">quality</span>
          <select value={quality} onChange={(e) => setQuality(e.currentTarget.value)}>
            <option value="">any quality</option>
            {Object.entries(words.quality).map(([word, name]) => (
              <option key={word} value={word}>
                {name}
              </option>
            ))}
          </select>
        </label>
        {may && (
          <button type="button" onClick={() => setBin(true)}>
            Bin
          </button>
        )}
      </div>
      {none && list.rows?.length === 0 && <p class="soft">{words.noTargets}</p>}
      {!none && list.rows?.length === 0 && <p class="soft">None is like that.</p>}
      {may && shown.length > 0 && <Marked names={chosen} more={list.more} all={shown.map((t) => t.name)} onMark={(names) => setMarked(new Set(names))} />}
      <ul class="contact">
        {shown.map((target) => (
          <li key={target.name}>
            <Card target={target} marked={may ? marked.has(target.name) : null} onMark={(is) => mark(target.name, is)} onOpen={() => setOpen(target.name)} />
          </li>
        ))}
      </ul>
      {list.more && <More shown={shown.length} onMore={list.next} />}
      {one && <Open target={one} onClose={() => setOpen(null)} />}
      {bin && <Bin onClose={() => setBin(false)} />}
    </main>
  );
}

function picture(name: string, kind: "thumb.jpg" | "image.png"): string {
  return address(`targets/${encodeURIComponent(name)}/${kind}`);
}

/** What is marked, and what is done with all of it. */
function Marked({ names, all, more, onMark }: { names: string[]; all: string[]; more: boolean; onMark: (names: string[]) => void }) {
  const [asks, setAsks] = useState(false);
  return (
    <div class="row marked" role="group" aria-label="marked views">
      <span class="soft">{names.length === 0 ? "none marked" : `${names.length} marked`}</span>
      {names.length < all.length && (
        <button type="button" class="small" onClick={() => onMark(all)}>
          {more ? "Mark these" : "Mark all"} {all.length}
        </button>
      )}
      {names.length > 0 && (
        <button type="button" class="small" onClick={() => onMark([])}>
          Mark none
        </button>
      )}
      {names.length > 0 && (
        <button type="button" class="small danger" onClick={() => setAsks(true)}>
          Remove {names.length} …
        </button>
      )}
      {asks && (
        <Dialog title={names.length === 1 ? "Take this view out?" : `Take these ${names.length} views out?`} onClose={() => setAsks(false)}>
          <p>{names.join(", ")}</p>
          <p class="soft">{words.bin}</p>
          <div class="row end">
            <button type="button" autofocus onClick={() => setAsks(false)}>
              Keep them
            </button>
            <button
              type="button"
              class="danger"
              onClick={() => {
                setAsks(false);
                void removeAll(names).then(onMark);
              }}
            >
              Yes, take them out
            </button>
          </div>
        </Dialog>
      )}
    </div>
  );
}

type CardOf = { target: Target; marked: boolean | null; onMark: (is: boolean) => void; onOpen: () => void };

/** Whether it is marked; nothing where nobody may mark it. */
function Mark({ name, marked, onMark }: { name: string; marked: boolean | null; onMark: (is: boolean) => void }) {
  if (marked === null) return null;
  return (
    <label class="mark">
      <span class="hidden">mark {name}</span>
      <input type="checkbox" checked={marked} onChange={(e) => onMark(e.currentTarget.checked)} />
    </label>
  );
}

function Card({ target, marked, onMark, onOpen }: CardOf) {
  const may = use((m) => m.me?.may_move ?? false);
  const mayStart = useMayStart();
  if (target.damaged) {
    return (
      <article class="target">
        <Mark name={target.name} marked={marked} onMark={onMark} />
        <h2>{target.name}</h2>
        <p class="bad">{target.damaged}</p>
      </article>
    );
  }
  const bar = scaleBar(target.um_per_px ?? null, target.width ?? 640);
  return (
    <article class={marked ? "target is-marked" : "target"}>
      <Mark name={target.name} marked={marked} onMark={onMark} />
      <div class="picture">
        <button type="button" onClick={onOpen} aria-label={`open ${target.name}`}>
          <img alt="" src={picture(target.name, "thumb.jpg")} loading="lazy" />
        </button>
        {bar && target.width && (
          <span class="scale" style={{ width: `${(100 * bar.px) / target.width}%` }}>
            {length(bar.um).replace(".0 ", " ").replace(".00 ", " ")}
          </span>
        )}
      </div>
      <h2>{target.name}</h2>
      <p class="soft">
        {[target.slide, target.objective, moment(target.saved)].filter(Boolean).join(" · ")}
      </p>
      <p>
        <span class={`tag ${target.quality?.word ?? ""}`}>{words.quality[target.quality?.word ?? "unknown"]}</span>{" "}
        <span class="soft why">{target.quality?.text}</span>
      </p>
      {target.note && <p class="note">{target.note}</p>}
      {may && (
        <button type="button" class="primary" disabled={!mayStart} onClick={() => void goBack(target.name)}>
          {words.back}
        </button>
      )}
    </article>
  );
}

function Open({ target, onClose }: { target: Target; onClose: () => void }) {
  const may = use((m) => m.me?.role !== "viewer");
  const needed = use((m) => (m.state?.jobs ?? []).some((job) => job.state.state !== "ended" && job.about === target.name));
  const [name, setName] = useState(target.name);
  const [slide, setSlide] = useState(target.slide ?? "");
  const [note, setNote] = useState(target.note ?? "");
  const [sure, setSure] = useState(false);
  const is = { name: name.trim(), slide: slide.trim(), note: note.trim() };
  const same = is.name === target.name && is.slide === (target.slide ?? "") && is.note === (target.note ?? "");
  return (
    <Dialog title={target.name} onClose={onClose}>
      <img class="large" alt={`the saved view ${target.name}`} src={picture(target.name, "image.png")} />
      <p>It {target.quality?.text}.</p>
      {target.note && <p class="note">{target.note}</p>}
      <p class="soft">
        {[target.slide && `slide ${target.slide}`, target.objective, `${target.features} features`, `saved ${moment(target.saved)}`, target.instrument].filter(Boolean).join(" · ")}
      </p>
      {may && (
        <form
          class="row edit"
          onSubmit={(event) => {
            event.preventDefault();
            const to = { slide: is.slide || null, note: is.note };
            void edit(target.name, is.name === target.name ? to : { ...to, name: is.name }).then(onClose);
          }}
        >
          <label>
            <span class="soft">name</span>
            <input value={name} readOnly={needed} onInput={(e) => setName(e.currentTarget.value)} />
          </label>
          <label>
            <span class="soft">slide</span>
            <input value={slide} onInput={(e) => setSlide(e.currentTarget.value)} />
          </label>
          <label class="grow">
            <span class="soft">note</span>
            <input value={note} onInput={(e) => setNote(e.currentTarget.value)} />
          </label>
          <button type="submit" disabled={same || is.name === ""}>
            Keep
          </button>
          <span class="grow" />
          {sure ? (
            <button type="button" class="danger" disabled={needed} onClick={() => void remove(target.name).then(onClose)}>
              Yes, take it out
            </button>
          ) : (
            <button type="button" disabled={needed} onClick={() => setSure(true)}>
              Remove …
            </button>
          )}
          {needed && <p class="soft">{words.needed}</p>}
        </form>
      )}
      <Visits target={target} />
      <div class="row end">
        <button
          type="button"
          onClick={() => {
            set({ chosen: target.name, chosenTarget: target });
            onClose();
          }}
        >
          Choose
        </button>
        <button type="button" class="primary" autofocus onClick={onClose}>
          Close
        </button>
      </div>
    </Dialog>
  );
}
