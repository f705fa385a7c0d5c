// Who may do what.

import { useEffect, useState } from "preact/hooks";
import { attempt } from "../api.ts";
import { logOut } from "./who.tsx";
import { use } from "../store.ts";

type One = { name: string; role: string };

const ROLES: [string, string][] = [
  ["viewer", "looks, and stops"],
  ["operator", "moves, saves and goes"],
  ["admin", "says who may"],
];

export function People() {
  const me = use((m) => m.me);
  const demo = use((m) => m.instrument?.demo ?? false);
  return (
    <main class="sheet">
      <div class="row wide">
        <h1>People</h1>
        <span class="grow" />
        <span class="soft">you are {me?.user}</span>
        <button
          type="button"
          onClick={logOut}
        >
          Log out
        </button>
      </div>
      {demo ? <p class="soft">The demonstration has one user.</p> : <List what="users" title="Users" withPassword />}
      <List what="tokens" title="Programs" />
      <Elsewhere />
    </main>
  );
}

/** Moving the instrument from another machine: off, until somebody here allows it for a while. */
function Elsewhere() {
  const left = use((m) => m.state?.elsewhere_s ?? null);
  const here = use((m) => m.me?.here ?? false);
  const allow = (minutes: number) => void attempt("POST", "elsewhere", { minutes });
  return (
    <section>
      <h2>From other machines</h2>
      <p>{left === null ? "People at other machines may look and stop, and move nothing." : `People at other machines may move the instrument for ${Math.ceil(left / 60)} min more.`}</p>
      {here && (
        <div class="row">
          <button type="button" onClick={() => allow(30)}>
            Let them move it for 30 minutes
          </button>
          <button type="button" disabled={left === null} onClick={() => allow(0)}>
            End that
          </button>
        </div>
      )}
    </section>
  );
}

function List({ what, title, withPassword }: { what: "users" | "tokens"; title: string; withPassword?: boolean }) {
  const [all, setAll] = useState<One[]>([]);
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const [role, setRole] = useState("viewer");
  const [token, setToken] = useState<string | null>(null);
  const load = () => void attempt<One[]>("GET", what).then((told) => told && setAll(told));
  useEffect(load, []);
  const add = async () => {
    const body = withPassword ? { name, password, role } : { name, role };
    const told = await attempt<{ token?: string }>("POST", what, body);
    if (!told) return;
    setToken(told.token ?? null);
    setName("");
    setPassword("");
    load();
  };
  return (
    <section>
      <h2>{title}</h2>
      <ul class="people">
        {all.map((one) => (
          <li key={one.name} class="row">
            <strong>{one.name}</strong>
            <span class="tag">{one.role}</span>
            <span class="grow" />
            <button type="button" class="small" onClick={() => void attempt("DELETE", `${what}/${encodeURIComponent(one.name)}`).then(load)}>
              Remove
            </button>
          </li>
        ))}
      </ul>
      {token && (
        <p class="notice">
          Copy it now, it is not shown again: <code>{token}</code>
        </p>
      )}
      <form
        class="row"
        onSubmit={(event) => {
          event.preventDefault();
          void add();
        }}
      >
        <label>
          <span class="hidden">name</span>
          <input required placeholder="name" value={name} onInput={(e) => setName(e.currentTarget.value)} />
        </label>
        {withPassword && (
          <label>
            <span class="hidden">password</span>
            <input type="password" required minLength={8} autocomplete="new-password" placeholder="password" value={password} onInput={(e) => setPassword(e.currentTarget.value)} />
          </label>
        )}
        <label>
          <span class="hidden">role</span>
          <select value={role} onChange={(e) => setRole(e.currentTarget.value)}>
            {ROLES.map(([word, means]) => (
              <option key={word} value={word}>
                {word}: {means}
              </option>
            ))}
          </select>
        </label>
        <button type="submit">Add</button>
      </form>
    </section>
  );
}
