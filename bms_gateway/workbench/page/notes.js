// The notes of a session: what is being written stays, and is kept by the desk a moment after the last key.
import { el, post, attempt, afterwards, ui, keep } from "./util.js";

const NOTES_MS = 600;
const MOST = 10000, DRAFT_MOST = 1000000; // characters that the session takes, and that this tab holds back
const box = el("textarea", { id: "notes-text", rows: "5", "aria-describedby": "notes-long", oninput: () => { long(); soon(); }, onchange: () => kept() });
const told = el("p", { class: "alarm", id: "notes-long", role: "status", hidden: true });
export const noteBox = el("div", {}, el("label", { for: "notes-text" }, "Notes, which the session file and the report take along"), box, told);
// What the session has; null: what this tab holds back is not sent yet.
let saved = (ui.draft ?? null) === null ? "" : null;

// What is written and not yet in the session outlives a reload of this tab. Notes that are too long are not cut: it is said as long as it is so.
const hold = (draft) => { if (draft !== (ui.draft ?? null)) keep({ draft }); };
function long() {
  const count = [...box.value].length, over = count > MOST, held = box.value.length <= DRAFT_MOST;
  told.hidden = !over;
  told.textContent = over ? `Notes: at most ${MOST} characters are kept, these are ${count}. ${held ? "They stay in this tab, and" : "Neither this tab nor"} the session file ${held ? "does not have" : "keeps"} them until they are shorter.` : "";
  hold(held && box.value !== saved ? box.value : null);
  return over;
}

const kept = attempt(async () => {
  const text = box.value;
  if (long()) throw new Error(told.textContent);
  if (text === saved) return;
  await post("note", { notes: text });
  saved = text;
  if (box.value === text) hold(null);
});
const soon = afterwards(NOTES_MS, kept);
if (saved === null) {
  box.value = ui.draft;
  if (!long()) kept();
}

// What could not be sent while the program was gone is sent when it is there again.
export const unsent = () => { if (box.value !== saved && !long()) kept(); };

// Other notes than those that this tab sent come with a session that is opened.
export function noted(now) {
  if (now !== saved && box.value === saved) { box.value = now; saved = now; }
}

// The report waits for what is being written.
export const sent = () => (box.value === saved ? null : kept());

// The link to the session file waits for what is being written; notes that are too long are told instead.
export async function withNotes(e) {
  if (box.value === saved) return; // the link does it
  e.preventDefault();
  const { href } = e.currentTarget;
  await kept();
  if (box.value === saved) el("a", { href, download: "session.json" }).click();
}
