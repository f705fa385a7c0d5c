// Dark, as rooms with microscopes are, light, or as the system has it: remembered by the browser.

import { useState } from "preact/hooks";
import { words } from "../words.ts";

const KEPT = "scopeservo-theme";
const USUAL = "dark";
const isLight = matchMedia("(prefers-color-scheme: light)");

function kept(): string {
  try {
    const theme = localStorage.getItem(KEPT) ?? USUAL;
    return theme in words.themes ? theme : USUAL;
  } catch {
    return USUAL;
  }
}

let chosen = kept();

export function applyTheme(theme = chosen): void {
  chosen = theme;
  const system = isLight.matches ? "light" : "dark";
  document.documentElement.dataset.theme = theme === "auto" ? system : theme;
}

isLight.addEventListener("change", () => applyTheme());

/** One of three. */
export function Theme() {
  const [theme, setTheme] = useState(chosen);
  const choose = (next: string) => {
    try {
      localStorage.setItem(KEPT, next);
    } catch {
      // Then it lasts as long as the page.
    }
    applyTheme(next);
    setTheme(next);
  };
  return (
    <label class="row">
      Colours
      <select value={theme} onChange={(e) => choose(e.currentTarget.value)}>
        {Object.entries(words.themes).map(([word, name]) => (
          <option key={word} value={word}>
            {name}
          </option>
        ))}
      </select>
    </label>
  );
}
