// Dialogs that keep the focus inside: saving, questions, help.

import type { ComponentChildren } from "preact";
import { useEffect, useRef } from "preact/hooks";

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
      {children}
    </dialog>
  );
}
