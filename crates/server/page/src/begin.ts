// How the page begins: who is here, what the instrument is, and the connection.

import { ask, Refused } from "./api.ts";
import { onState, refresh } from "./heard.ts";
import { connect } from "./socket.ts";
import { set } from "./store.ts";
import type { Me, State } from "./types.ts";

/** The terminal's key, out of the address, where it must not stay. */
export function takeKey(): string | null {
  const found = /^#key=([0-9a-f]+)$/.exec(location.hash);
  if (!found) return null;
  history.replaceState(null, "", location.pathname + location.search);
  return found[1];
}

export async function enter(): Promise<void> {
  const key = takeKey();
  if (key !== null) {
    try {
      const told = await ask<{ claim: boolean }>("POST", "enter", { key });
      if (told.claim) {
        set({ claim: key, me: null });
        return;
      }
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      set({ refused: error.failure });
    }
  }
  await begin();
}

/** Once somebody is known. */
export async function begin(): Promise<void> {
  try {
    const me = await ask<Me>("GET", "me");
    set({ me, claim: null });
    connect();
    onState(await ask<State>("GET", "state"));
    await refresh();
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (error.status !== 401) set({ refused: error.failure });
    set({ me: null });
  }
}
