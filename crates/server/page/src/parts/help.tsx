import { set, use } from "../store.ts";
import { words } from "../words.ts";
import { Dialog } from "./dialog.tsx";

export function Help() {
  const shown = use((m) => m.help);
  if (!shown) return null;
  const close = () => set({ help: false });
  return (
    <Dialog title="Keys" onClose={close}>
      <dl class="keys">
        {words.keys.map(([key, what]) => (
          <div key={key}>
            <dt>
              <kbd>{key}</kbd>
            </dt>
            <dd>{what}</dd>
          </div>
        ))}
      </dl>
      <p class="soft">Click in the view to bring that place to the middle; drag to move it; the wheel steps the focus.</p>
      <div class="row end">
        <button type="button" class="primary" onClick={close}>
          Close
        </button>
      </div>
    </Dialog>
  );
}
