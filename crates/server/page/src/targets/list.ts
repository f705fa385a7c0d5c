// The saved views that are looked for: found by the server, which knows all of them, and shown by and by.

import { useEffect, useRef, useState } from "preact/hooks";
import { ask, Refused } from "../api.ts";
import { set, use } from "../store.ts";
import type { Target } from "../types.ts";

/** So many are asked for at once, and so many at most in one answer. */
export const PAGE = 100;
const MOST = 500;
/** So long nobody has typed before it is looked for, ms. */
const STILL = 200;

export type Wanted = { text: string; slide: string; quality: string };

/** One more than are wanted tells whether there are more. */
async function some({ text, slide, quality }: Wanted, count: number, after: string | undefined): Promise<{ rows: Target[]; more: boolean }> {
  const limit = Math.min(MOST, count + 1);
  const asked = new URLSearchParams({ limit: String(limit) });
  if (text.trim()) asked.set("text", text.trim());
  if (slide) asked.set("slide", slide);
  if (quality) asked.set("quality", quality);
  if (after !== undefined) asked.set("after", after);
  const rows = await ask<Target[]>("GET", `targets?${asked}`);
  return { rows: rows.slice(0, limit - 1), more: rows.length === limit };
}

/** As many of them as are wanted, from the newest on. */
async function first(wanted: Wanted, count: number): Promise<{ rows: Target[]; more: boolean }> {
  let all: Target[] = [];
  for (;;) {
    const { rows, more } = await some(wanted, count - all.length, all.at(-1)?.name);
    all = [...all, ...rows];
    if (!more || all.length >= count) return { rows: all, more };
  }
}

export type List = { rows: Target[] | null; more: boolean; next: () => void };

export function useList(wanted: Wanted): List {
  const revision = use((m) => m.state?.revision ?? 0);
  const [found, setFound] = useState<{ rows: Target[] | null; more: boolean }>({ rows: null, more: false });
  // What was asked before is no answer any more when something else is asked.
  const turn = useRef(0);
  const before = useRef("");
  const asks = useRef(false);
  const key = JSON.stringify(wanted);
  const look = async (begin: () => Promise<{ rows: Target[]; more: boolean }>) => {
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
    const timer = setTimeout(() => void look(() => first(wanted, count)), isSame || found.rows === null ? 0 : STILL);
    return () => clearTimeout(timer);
  }, [key, revision]);
  const next = () => {
    const rows = found.rows ?? [];
    if (asks.current || !found.more) return;
    void look(async () => {
      try {
        const came = await some(wanted, PAGE, rows.at(-1)?.name);
        const has = new Set(rows.map((row) => row.name));
        return { rows: [...rows, ...came.rows.filter((row) => !has.has(row.name))], more: came.more };
      } catch (error) {
        // The last one that was shown is gone: from the beginning.
        if (error instanceof Refused && error.status === 404) return await first(wanted, rows.length + PAGE);
        throw error;
      }
    });
  };
  return { ...found, next };
}
