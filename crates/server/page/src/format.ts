// Numbers and moments as people read them.

/** A number of so many decimals, without a sign of nothing. */
export function fixed(value: number, decimals: number): string {
  const text = value.toFixed(decimals);
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text;
}

/** A length in um, in the unit that suits it. */
export function length(um: number): string {
  const size = Math.abs(um);
  if (size >= 1000) return `${fixed(um / 1000, size >= 10_000 ? 1 : 2)} mm`;
  // Nothing is known to nothing.
  if (size > 0 && size < 0.005) return "less than 0.01 µm";
  if (size >= 10) return `${fixed(um, 1)} µm`;
  return `${fixed(um, 2)} µm`;
}

/** A fine step of the focus, um: about a depth of field of usual objectives at this scale. */
export function fineStep(umPerPx: number): number {
  return Math.max(0.5, Math.round(umPerPx * 4 * 2) / 2);
}

/** How old something is, said once it matters. */
export function age(seconds: number): string {
  if (seconds < 2) return "";
  if (seconds < 100) return `${Math.round(seconds)} s old`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min old`;
  return `${Math.round(seconds / 3600)} h old`;
}

/** A moment as files have it, for people at this clock. */
export function moment(utc: string): string {
  const at = new Date(utc);
  if (Number.isNaN(at.getTime())) return utc;
  const two = (n: number) => String(n).padStart(2, "0");
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} ${two(at.getHours())}:${two(at.getMinutes())}`;
}

/** Seconds for people. */
export function duration(seconds: number): string {
  return seconds < 100 ? `${fixed(seconds, 1)} s` : `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

/** A free name like view-3. */
export function freeName(stem: string, taken: string[]): string {
  const has = new Set(taken.map((name) => name.toLowerCase()));
  for (let n = 1; ; n++) {
    const name = `${stem}-${n}`;
    if (!has.has(name)) return name;
  }
}

/** A word that programs use, for people. */
export function spaced(word: string): string {
  return word.replaceAll("_", " ");
}

/** A sentence of the program, with units as people write them. */
export function withUnits(text: string): string {
  return text.replace(/(\d) um\b/g, "$1 µm").replace(/(\d) deg\b/g, "$1°");
}
