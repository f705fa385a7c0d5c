// The page: one of four, between an edge above and one below that are always there.

import { render } from "preact";
import { enter } from "./begin.ts";
import { listen } from "./keys.ts";
import { Live } from "./live/live.tsx";
import { Bottom } from "./parts/bottom.tsx";
import { Help } from "./parts/help.tsx";
import { Notices } from "./parts/notice.tsx";
import { Questions } from "./parts/questions.tsx";
import { Saving } from "./parts/saving.tsx";
import { applyTheme } from "./parts/theme.tsx";
import { Top } from "./parts/top.tsx";
import { Enter } from "./people/enter.tsx";
import { People } from "./people/people.tsx";
import { Runs } from "./run/runs.tsx";
import { use } from "./store.ts";
import { Targets } from "./targets/targets.tsx";
import { words } from "./words.ts";

function App() {
  const me = use((m) => m.me);
  const page = use((m) => m.page);
  if (me === undefined) return <p class="waiting">{words.opening}</p>;
  if (me === null) return <Enter />;
  return (
    <>
      <Top />
      <Notices />
      {page === "live" && <Live />}
      {page === "targets" && <Targets />}
      {page === "runs" && <Runs />}
      {page === "people" && <People />}
      <Bottom />
      <Saving />
      <Questions />
      <Help />
    </>
  );
}

applyTheme();
const root = document.getElementById("app");
if (root) render(<App />, root);
listen();
void enter();
