// How one comes in.

import { useState } from "preact/hooks";
import { attempt } from "../api.ts";
import { begin } from "../begin.ts";
import { Notices } from "../parts/notice.tsx";
import { use } from "../store.ts";

export function Enter() {
  const key = use((m) => m.claim);
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const submit = async () => {
    const told = key === null ? await attempt("POST", "login", { name, password }) : await attempt("POST", "claim", { key, name, password });
    if (told) await begin();
  };
  return (
    <main class="enter">
      <h1>scopeservo</h1>
      <p>{key === null ? "Log in to look at the instrument." : "You are the first one here. Say who you are: you will be the one who lets others in."}</p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void submit();
        }}
      >
        <label>
          Name
          <input autofocus required autocomplete="username" value={name} onInput={(e) => setName(e.currentTarget.value)} />
        </label>
        <label>
          Password
          <input
            type="password"
            required
            minLength={8}
            autocomplete={key === null ? "current-password" : "new-password"}
            value={password}
            onInput={(e) => setPassword(e.currentTarget.value)}
          />
        </label>
        <button type="submit" class="primary">
          {key === null ? "Log in" : "Begin"}
        </button>
      </form>
      {key === null && <p class="soft">The first time, open the link that the program prints on its terminal.</p>}
      <Notices />
    </main>
  );
}
