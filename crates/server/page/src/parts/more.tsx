// The end of a list that goes on.

import { useEffect, useRef } from "preact/hooks";

/** The next ones come when one asks for them, or has looked so far. */
export function More({ shown, onMore }: { shown: number; onMore: () => void }) {
  const button = useRef<HTMLButtonElement>(null);
  const more = useRef(onMore);
  more.current = onMore;
  useEffect(() => {
    if (!button.current) return;
    const seen = new IntersectionObserver((all) => all.some((one) => one.isIntersecting) && more.current());
    seen.observe(button.current);
    return () => seen.disconnect();
    // Anew for each page: what stays in sight is no change of sight.
  }, [shown]);
  return (
    <p class="more">
      <button type="button" ref={button} onClick={onMore}>
        Show more
      </button>{" "}
      <span class="soft">{shown} are shown</span>
    </p>
  );
}
