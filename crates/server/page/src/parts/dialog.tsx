// Dialogs that keep the focus inside: saving, questions, help. What lies below cannot be pressed meanwhile, so each has its own Stop,
// above at the right, but the last to come to by Tab: Enter is not to press it by accident.

import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { stop } from "../act.ts";
import { words } from "../words.ts";

type Props = { title: string; children: ComponentChildren; onClose?: () => void; alert?: boolean };

export function Dialog({ title, children, onClose, alert }: Props) {
  const box = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    const dialog = box.current;
    const before = document.activeElement as HTMLElement | null;
    if (dialog && !dialog.open) dialog.showModal();
    return () => before?.focus();
  }, []);
  return (
    <dialog
      ref={box}
      class="dialog"
      role={alert ? "alertdialog" : undefined}
      aria-label={title}
      onCancel={(event) => {
        event.preventDefault();
        onClose?.();
      }}
    >
      <h2>{title}</h2>
      <div class="inside">{children}</div>
      <button type="button" class="verb stop" onClick={stop}>
        {words.stop} <kbd>Esc</kbd>
      </button>
    </dialog>
  );
}
