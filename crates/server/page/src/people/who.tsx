// Who sits here, who else is there, and how somebody else sits down without the view going away.

import { useState } from "preact/hooks";
import { ask, attempt, Refused } from "../api.ts";
import { begin } from "../begin.ts";
import { releaseAll } from "../live/hold.ts";
import { Dialog } from "../parts/dialog.tsx";
import { Theme } from "../parts/theme.tsx";
import { disconnect } from "../socket.ts";
import { set, use } from "../store.ts";
import { words } from "../words.ts";

export function Who() {
  const me = use((m) => m.me?.user ?? "");
  const [open, setOpen] = useState(false);
  return (
    <>
      <button type="button" class="small who" aria-haspopup="dialog" onClick={() => setOpen(true)}>
        <span class="hidden">you are </span>
        <span class="which">{me}</span> ▾
      </button>
      {open && <Here onClose={() => setOpen(false)} />}
    </>
  );
}

export function logOut(): void {
  releaseAll();
  void attempt("POST", "logout").then(() => {
    disconnect();
    set({ me: null });
  });
}

function Here({ onClose }: { onClose: () => void }) {
  const me = use((m) => m.me);
  const demo = use((m) => m.instrument?.demo ?? false);
  const others = use((m) => m.state?.there ?? []).filter((one) => one !== me?.user);
  return (
    <Dialog title={`You are ${me?.user}`} onClose={onClose}>
      <p>
        {me?.role}
        {me?.here ? ", at the microscope" : ", at another machine"}
        {others.length > 0 && `. Also there: ${others.join(", ")}`}
      </p>
      {demo ? <p class="soft">The demonstration has one user.</p> : <Change onClose={onClose} />}
      <h3>Page</h3>
      <Theme />
      <div class="row end">
        {!demo && (
          <button type="button" onClick={logOut}>
            Log out
          </button>
        )}
        <button type="button" onClick={onClose}>
          Close
        </button>
      </div>
    </Dialog>
  );
}

/** Another name and password: the page stays as it is. */
function Change({ onClose }: { onClose: () => void }) {
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const [wrong, setWrong] = useState<string | null>(null);
  const change = async () => {
    releaseAll();
    try {
      await ask("POST", "login", { name, password });
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      setWrong(error.failure.message);
      return;
    }
    disconnect();
    set({ refused: null });
    await begin();
    onClose();
  };
  return (
    <>
      <h3>Change of user</h3>
      <p class="soft">{words.change}</p>
      <form
        class="change"
        onSubmit={(event) => {
          event.preventDefault();
          void change();
        }}
      >
        <label>
          Name
          <input required autofocus autocomplete="username" value={name} onInput={(e) => setName(e.currentTarget.value)} />
        </label>
        <label>
          Password
          <input type="password" required minLength={8} autocomplete="current-password" value={password} onInput={(e) => setPassword(e.currentTarget.value)} />
        </label>
        {wrong && (
          <p class="bad" role="alert">
            {wrong}
          </p>
        )}
        <button type="submit" class="primary">
          Sit down
        </button>
      </form>
    </>
  );
}
