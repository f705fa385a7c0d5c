// What is asked of the server.

import { set } from "./store.ts";
import type { Failure } from "./types.ts";

/** Refused, or failed, with a sentence. */
export class Refused extends Error {
  failure: Failure;
  status: number;

  constructor(status: number, failure: Failure) {
    super(failure.message);
    this.failure = failure;
    this.status = status;
  }
}

const LOST: Failure = { code: "no_connection", kind: "fault", message: "The computer at the microscope does not answer. What it does now is not known here." };

/** Addresses are relative, so that the page may lie under any path. */
export function address(path: string): string {
  return `api/v1/${path}`;
}

/** The answer to a request; what is refused is thrown. */
async function told<T>(path: string, request: RequestInit): Promise<T> {
  let response: Response;
  try {
    response = await fetch(path, { credentials: "same-origin", ...request });
  } catch {
    throw new Refused(0, LOST);
  }
  const told = await response.json().catch(() => null);
  if (response.ok && told !== null) return told as T;
  const failure = (told ?? { code: "no_answer", kind: "fault", message: `The server answered ${response.status}.` }) as Failure;
  if (response.status === 401 && failure.code === "not_logged_in") set({ me: null });
  throw new Refused(response.status, failure);
}

export async function ask<T>(method: string, path: string, body?: unknown): Promise<T> {
  const request = method === "GET" ? {} : { headers: { "content-type": "application/json" }, body: JSON.stringify(body ?? {}) };
  return told<T>(address(path), { method, ...request });
}

/** Sends a file as what it is. */
export async function send<T>(path: string, kind: string, file: Blob): Promise<T> {
  return told<T>(path, { method: "PUT", headers: { "content-type": kind }, body: file });
}

/** Asks, and shows what is refused until somebody has read it. */
export async function attempt<T>(method: string, path: string, body?: unknown): Promise<T | null> {
  try {
    const told = await ask<T>(method, path, body);
    set({ refused: null });
    return told;
  } catch (error) {
    if (error instanceof Refused) set({ refused: error.failure });
    else throw error;
    return null;
  }
}
