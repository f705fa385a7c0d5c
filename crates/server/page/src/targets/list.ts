// Lists that may be long: what is found by the server, which knows all of it, and shown by and by.

import { useEffect, useRef, useState } from "preact/hooks";
import { ask, Refused } from "../api.ts";
import { set, use } from "../store.ts";
import type { Run, Target } from "../types.ts";

/** So many are asked for at once, and so many at most in one answer. */
export const PAGE = 100;
const MOST = 500;
/** So long nobody has typed before it is looked for, ms. */
const STILL = 200;

/** What is asked for: where, by what, how the next ones are asked for after one that is shown, and what tells one from another. */
type Source<T> = { path: string; wanted: Record<string, string>; next: (row: T) => [string, string]; key: (row: T) => string };

type Some<T> = { rows: T[]; more: boolean };

/** One more than are wanted tells whether there are more. */
async function some<T>({ path, wanted, next }: Source<T>, count: number, last: T | undefined): Promise<Some<T>> {
  const limit = Math.min(MOST, count + 1);
  const asked = new URLSearchParams({ ...wanted, limit: String(limit) });
  if (last !== undefined) asked.set(...next(last));
  const rows = await ask<T[]>("GET", `${path}?${asked}`);
  return { rows: rows.slice(0, limit - 1), more: rows.length === limit };
}

/** As many of them as are wanted, from the newest on. */
async function first<T>(source: Source<T>, count: number): Promise<Some<T>> {
  let all: T[] = [];
  for (;;) {
    const { rows, more } = await some(source, count - all.length, all.at(-1));
    all = [...all, ...rows];
    if (!more || all.length >= count) return { rows: all, more };
  }
}

export type List<T> = { rows: T[] | null; more: boolean; next: () => void };

function useRows<T>(source: Source<T>): List<T> {
  const revision = use((m) => m.state?.revision ?? 0);
  const [found, setFound] = useState<{ rows: T[] | null; more: boolean }>({ rows: null, more: false });
  // What was asked before is no answer any more when something else is asked.
  const turn = useRef(0);
  const before = useRef("");
  const asks = useRef(false);
  const key = JSON.stringify([source.path, source.wanted]);
  const look = async (begin: () => Promise<Some<T>>) => {
    const own = ++turn.current;
    asks.current = true;
    try {
      const came = await begin();
      if (own === turn.current) setFound(came);
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      if (own === turn.current) set({ refused: error.failure });
    } finally {
      if (own === turn.current) asks.current = false;
    }
  };
  useEffect(() => {
    // The same ones looked at anew stay as many as were shown.
    const isSame = before.current === key;
    before.current = key;
    const count = isSame ? Math.max(PAGE, found.rows?.length ?? 0) : PAGE;
    const timer = setTimeout(() => void look(() => first(source, count)), isSame || found.rows === null ? 0 : STILL);
    return () => clearTimeout(timer);
  }, [key, revision]);
  const next = () => {
    const rows = found.rows ?? [];
    if (asks.current || !found.more) return;
    void look(async () => {
      try {
        const came = await some(source, PAGE, rows.at(-1));
        const has = new Set(rows.map(source.key));
        return { rows: [...rows, ...came.rows.filter((row) => !has.has(source.key(row)))], more: came.more };
      } catch (error) {
        // The last one that was shown is gone: from the beginning.
        if (error instanceof Refused && error.status === 404) return await first(source, rows.length + PAGE);
        throw error;
      }
    });
  };
  return { ...found, next };
}

/** What was given, without what was not. */
function given(all: Record<string, string>): Record<string, string> {
  return Object.fromEntries(Object.entries(all).filter(([, value]) => value !== ""));
}

/** Saved views by what is looked for. */
export function useTargets({ text, slide, quality }: { text: string; slide: string; quality: string }): List<Target> {
  return useRows<Target>({ path: "targets", wanted: given({ text: text.trim(), slide, quality }), next: (row) => ["after", row.name], key: (row) => row.name });
}

/** What lies in the bin, where several may have one name. */
export function useBin(): List<Target> {
  return useRows<Target>({ path: "targets", wanted: { bin: "true" }, next: (row) => ["after_number", String(row.number)], key: (row) => String(row.number) });
}

/** What was done; of a saved view, where one is named. */
export function useRuns(target = ""): List<Run> {
  return useRows<Run>({ path: "runs", wanted: given({ target }), next: (row) => ["before", row.id], key: (row) => row.id });
}
