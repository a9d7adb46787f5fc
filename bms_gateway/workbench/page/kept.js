// Uploaded files, kept in this browser: a program that was started anew and a duplicated tab get them from here.
import { ui, keep } from "./util.js";

const MIB = 1024 ** 2;
const ONE = 64 * MIB, ALL = 256 * MIB, DAYS = 7; // of one file, of all tabs together, and since it was used last
const STORE = "files";

let base = null;
const open = () => (base ??= new Promise((done, failed) => {
  const asked = indexedDB.open("uploads", 1);
  asked.onupgradeneeded = () => asked.result.createObjectStore(STORE, { keyPath: "key" });
  asked.onsuccess = () => done(asked.result);
  asked.onerror = () => { base = null; failed(asked.error); };
}));

// Runs one transaction; gives what its request gave when all of it is on disk.
async function within(mode, work) {
  const change = (await open()).transaction(STORE, mode);
  return new Promise((done, failed) => {
    const asked = work(change.objectStore(STORE));
    change.oncomplete = () => done(asked?.result);
    change.onabort = change.onerror = () => failed(change.error);
  });
}

const now = () => Date.now();
const size = (bytes) => `${(bytes / MIB).toFixed(0)} MiB`;
const note = (name, why) => keep({ unkept: { ...ui.unkept, [name]: why } });

// Makes room: what was not used for long goes, and of the rest what was used longest ago; this tab's files stay.
async function room(bytes) {
  const mine = Object.values(ui.uploads), files = (await within("readonly", (s) => s.getAll())).sort((a, b) => a.used - b.used);
  let held = files.reduce((sum, f) => sum + f.blob.size, 0);
  const gone = files.filter((f) => {
    const goes = !mine.includes(f.key) && (now() - f.used > DAYS * 864e5 || held + bytes > ALL);
    if (goes) held -= f.blob.size;
    return goes;
  });
  await within("readwrite", (s) => { for (const f of gone) s.delete(f.key); });
  return held + bytes <= ALL;
}

// Keeps a file that this tab has uploaded under a name. A file of the same name takes its place for this tab; a
// duplicated tab still has the one before. What cannot be kept is noted, with the reason.
export async function put(file, name) {
  const { [name]: _, ...rest } = ui.uploads, { [name]: __, ...others } = ui.unkept;
  keep({ uploads: rest, unkept: others });
  if (file.size > ONE) return note(name, `has ${size(file.size)}, and one file may have ${size(ONE)}`);
  try {
    if (!(await room(file.size))) return note(name, `does not fit: all files together may have ${size(ALL)}`);
    const key = [...crypto.getRandomValues(new Uint32Array(4))].join("-");
    await within("readwrite", (s) => s.put({ key, blob: file, used: now() }));
    return keep({ uploads: { ...ui.uploads, [name]: key } });
  } catch (e) {
    return note(name, `could not be written: ${e?.name === "QuotaExceededError" ? "the browser gives no more room" : e?.message ?? "the browser keeps nothing"}`);
  }
}

// Gives every file that this tab has uploaded to `send`; those that are not here any more are noted.
export async function each(send) {
  for (const [name, key] of Object.entries(ui.uploads)) {
    const found = await within("readonly", (s) => s.get(key)).catch(() => null);
    if (!found) { note(name, "is not there any more"); continue; }
    await send(new File([found.blob], name));
    await within("readwrite", (s) => s.put({ ...found, used: now() })).catch(() => null); // it was used, whether noted or not
  }
}

// Notes that the files that this tab has uploaded by now are those that are opened.
export const opened = () => keep({ opened: { ...ui.uploads } });

// Files that were uploaded anew after they were opened: what was open cannot come back from them.
export const changed = () => Object.entries(ui.opened).filter(([name, key]) => ui.uploads[name] && ui.uploads[name] !== key).map(([name]) => name);

// What this browser does not keep, as a sentence; empty where there is nothing of the kind.
export const lacking = () => Object.entries(ui.unkept).map(([name, why]) => `${name} ${why}`).join("; ");
