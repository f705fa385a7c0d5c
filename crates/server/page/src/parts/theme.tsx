// Dark, as rooms with microscopes are; light for whoever wants it, remembered by the browser.

import { useState } from "preact/hooks";

const KEPT = "scopeservo-theme";

function kept(): string {
  try {
    return localStorage.getItem(KEPT) ?? "dark";
  } catch {
    return "dark";
  }
}

export function applyTheme(theme = kept()): void {
  document.documentElement.dataset.theme = theme;
}

export function Theme() {
  const [theme, setTheme] = useState(kept);
  const other = theme === "dark" ? "light" : "dark";
  return (
    <button
      type="button"
      class="small"
      aria-label={`make the page ${other}`}
      onClick={() => {
        try {
          localStorage.setItem(KEPT, other);
        } catch {
          // Then it lasts as long as the page.
        }
        applyTheme(other);
        setTheme(other);
      }}
    >
      ◐
    </button>
  );
}
