// What is refused or wrong, where it stays until somebody has read it.

import { withUnits } from "../format.ts";
import { set, use } from "../store.ts";
import { words } from "../words.ts";

export function Notices() {
  const refused = use((m) => m.refused);
  const link = use((m) => m.link);
  const trouble = use((m) => m.state?.trouble ?? m.state?.camera.trouble ?? null);
  return (
    <div class="notices" aria-live="assertive">
      {link === "lost" && <p class="notice bad">{words.lost}</p>}
      {link === "polling" && <p class="notice">{words.polling}</p>}
      {trouble && link !== "lost" && <p class="notice bad">{trouble}</p>}
      {refused && (
        <p class="notice bad" role="alert">
          <span>{withUnits(refused.message)}</span>
          <button type="button" class="small" onClick={() => set({ refused: null })}>
            Understood
          </button>
        </p>
      )}
    </div>
  );
}
