#!/usr/bin/env node
// Follows the journal of a workspace, as docs/journal.md tells it, without the Python package and without dependencies.
//
//   node follow.mjs WORKSPACE... --hash    one JSON line a workspace: records, seq, sha256; damage if there is any
//   node follow.mjs WORKSPACE --follow     one JSON line a record, as they come; --until SEQ ends there
//
// --lane NAME chooses a lane where a workspace has several. Exit code: 0, 1 damage found, 2 wrong arguments.
// The steps of `advance` are those of docs/journal.md; the two are changed together.

import { createHash } from 'node:crypto';
import { closeSync, fstatSync, openSync, readdirSync, readSync, watch } from 'node:fs';
import { hostname } from 'node:os';
import { join } from 'node:path';
import { parseArgs } from 'node:util';
import { crc32 } from 'node:zlib';

const SEGMENT = /^(\d{4}-\d{2}-\d{2})\.(\d{3,})\.md$/;
const FRONT =
  /^---\nphy: journal\/1\nlane: (.+)\nsegment: (.+)\nfirst_seq: (\d+)\nprev: (.+)\nprev_sha256: (.+)\n---\n\n# Session journal (.+)\n\n/;
const FRONT_BYTES = 2048;
const HEADER = /^<!-- phy1 (\d{10}) (\d{6}) ([0-9a-f]{8}) -->\n$/;
const HEADER_BYTES = 41;
const MARK = Buffer.from('<!-- phy1 ');
const LOOK_AGAIN_MS = 100; // longer than a writer needs to cut a torn end
const POLL_MS = 1000;
const UTF8 = new TextDecoder('utf-8', { fatal: true, ignoreBOM: true });

class Damage extends Error {
  constructor(segment, offset, reason) {
    super(`segment ${segment}, offset ${offset}: ${reason}`);
    this.found = { segment, offset, reason };
  }
}

/** A header at `at`, or null. */
function readHeader(data, at) {
  if (at + HEADER_BYTES > data.length) return null;
  const match = HEADER.exec(data.toString('latin1', at, at + HEADER_BYTES));
  return match && { seq: Number(match[1]), length: Number(match[2]), crc: parseInt(match[3], 16) };
}

function isIntact(header, payload) {
  return crc32(payload, header.seq % 2 ** 32) === header.crc;
}

function isText(value) {
  return typeof value === 'string';
}

function isNumber(value) {
  return value === undefined || Number.isInteger(value);
}

/** The first line as an object with the Markdown below it, or null when it is not what a record begins with. */
function decode(payload) {
  try {
    const text = UTF8.decode(payload);
    const end = text.indexOf('\n');
    if (!text.startsWith('- ') || !text.endsWith('\n')) return null;
    const line = JSON.parse(text.slice(2, end));
    const isLine =
      [line.id, line.ev, line.by, line.side, line.at].every(isText) &&
      [line.from, line.to].every((each) => each === undefined || each === null || isText(each)) &&
      (line.ep === null || isNumber(line.ep)) &&
      isNumber(line.more);
    return isLine ? { ...line, more: line.more ?? 0, markdown: text.slice(end + 1) } : null;
  } catch {
    return null;
  }
}

/** Whole batches at the beginning of `data`: step 4; and what stands behind them: step 5. */
function scan(data, lastSeq) {
  const records = [];
  let at = 0, seq = lastSeq, end = 0, whole = 0;
  for (;;) {
    const header = readHeader(data, at);
    if (header === null || header.seq !== seq + 1) break;
    const stop = at + HEADER_BYTES + header.length;
    const payload = data.subarray(at + HEADER_BYTES, stop);
    if (stop > data.length || !isIntact(header, payload)) break;
    const record = decode(payload);
    if (record === null) break;
    records.push({ seq: header.seq, ...record });
    at = stop;
    seq += 1;
    if (record.more === 0) {
      end = at;
      whole = records.length;
    }
  }
  return { records: records.slice(0, whole), end, tail: end === data.length ? 'clean' : judge(data.subarray(at), seq + 1) };
}

function judge(rest, next) {
  if (rest.every((byte) => byte === 0)) return 'torn';
  const someHeader = Buffer.from(`<!-- phy1 ${String(next).padStart(10, '0')} 000000 00000000 -->\n`);
  const header = readHeader(Buffer.concat([rest, someHeader.subarray(rest.length)]), 0);
  if (header === null || header.seq !== next) return 'damaged';
  if (rest.length < HEADER_BYTES) return 'torn';
  const payload = rest.subarray(HEADER_BYTES);
  const isShort = payload.length < header.length;
  return isShort && !isIntact(header, payload) && !holdsRecord(payload) ? 'torn' : 'damaged';
}

function holdsRecord(data) {
  for (let at = data.indexOf(MARK); at >= 0; at = data.indexOf(MARK, at + 1)) {
    const header = readHeader(data, at);
    if (header === null) continue;
    const payload = data.subarray(at + HEADER_BYTES, at + HEADER_BYTES + header.length);
    if (payload.length === header.length && isIntact(header, payload)) return true;
  }
  return false;
}

function listFolder(folder) {
  try {
    return readdirSync(folder);
  } catch (error) {
    if (error.code === 'ENOENT' || error.code === 'ENOTDIR') return [];
    throw error;
  }
}

class Follower {
  constructor(workspace, lane) {
    this.sessions = join(workspace, 'sessions');
    this.lane = lane ?? chooseLane(this.sessions);
    this.seq = 0;
    this.records = 0;
    this.name = null; // current segment
    this.isRead = true; // whether it is read to its end and grows no more
    this.offset = 0;
    this.file = -1;
    this.digest = null; // of the current file, as far as it was read
    this.hash = createHash('sha256'); // of every record
    this.tail = 'clean';
  }

  /** Step 1: [name, path] of every segment, oldest first. */
  list() {
    const found = new Map();
    const add = (folder) => {
      for (const file of listFolder(folder)) {
        const name = file.slice(0, -3);
        if (SEGMENT.test(file) && !found.has(name)) found.set(name, join(folder, file));
      }
    };
    add(join(this.sessions, this.lane));
    const archive = join(this.sessions, 'archive');
    for (const month of listFolder(archive)) add(join(archive, month, this.lane));
    return [...found].sort(([a], [b]) => compareNames(a, b));
  }

  findNext() {
    return this.list().find(([name]) => this.name === null || compareNames(name, this.name) > 0) ?? null;
  }

  /** Step 2. False when the file is no longer where it was listed. */
  enter([name, path]) {
    let file;
    try {
      file = openSync(path, 'r');
    } catch (error) {
      if (error.code === 'ENOENT') return false;
      throw error;
    }
    const head = readAll(file, 0).subarray(0, FRONT_BYTES).toString('utf8');
    const match = FRONT.exec(head);
    const sealed = this.digest === null ? 'none' : this.digest.copy().digest('hex');
    const expected = [this.lane, name, String(this.seq + 1), this.name ?? 'none', sealed, name];
    if (match === null || expected.some((each, index) => each !== match[index + 1])) {
      closeSync(file);
      const what = match === null ? 'no front matter of a segment' : `begins with ${match.slice(1, 6).join(', ')}`;
      const reason = `${name} ${what}; expected ${expected.slice(0, 5).join(', ')}`;
      const isItself = match !== null && [0, 1, 5].every((index) => match[index + 1] === expected[index]);
      if (this.name !== null && isItself) throw new Damage(this.name, this.offset, `it ends here, but ${reason}`);
      throw new Damage(name, 0, reason);
    }
    if (this.file >= 0) closeSync(this.file);
    this.file = file;
    this.name = name;
    this.isRead = false;
    this.offset = Buffer.byteLength(match[0]);
    this.digest = createHash('sha256').update(match[0]);
    return true;
  }

  /** Steps 2 to 6: the records that are new. Throws Damage; what was read before stays counted. */
  *advance() {
    for (;;) {
      if (this.isRead) {
        const next = this.findNext();
        if (next === null) return;
        if (!this.enter(next)) continue; // it was archived since
      }
      const later = this.findNext();
      const size = fstatSync(this.file).size;
      if (size < this.offset) throw new Damage(this.name, size, `the file ends here, record ${this.seq} further on`);
      const data = readAll(this.file, this.offset);
      const { records, end, tail } = scan(data, this.seq);
      this.hash.update(data.subarray(0, end));
      this.digest.update(data.subarray(0, end));
      this.offset += end;
      this.records += records.length;
      this.seq += records.length;
      this.tail = tail;
      yield* records;
      if (tail === 'damaged' || (tail === 'torn' && later !== null))
        throw new Damage(this.name, this.offset, `record ${this.seq + 1} or one of its batch is not as it was written`);
      if (later === null) return;
      this.isRead = true;
    }
  }

  /** `advance`, with a second look before it believes in damage. */
  async *read() {
    try {
      yield* this.advance();
    } catch (error) {
      if (!(error instanceof Damage)) throw error;
      await new Promise((resolve) => setTimeout(resolve, LOOK_AGAIN_MS));
      yield* this.advance();
    }
  }

  summary() {
    const sha256 = this.hash.copy().digest('hex');
    return { records: this.records, seq: this.seq, sha256, tail: this.tail };
  }
}

function compareNames(a, b) {
  const [dayA, numberA] = [a.slice(0, 10), Number(a.slice(11))];
  const [dayB, numberB] = [b.slice(0, 10), Number(b.slice(11))];
  return dayA < dayB ? -1 : dayA > dayB ? 1 : numberA - numberB;
}

function readAll(file, offset) {
  const parts = [];
  for (let at = offset; ; ) {
    const part = Buffer.allocUnsafe(1 << 20);
    const count = readSync(file, part, 0, part.length, at);
    if (count === 0) return Buffer.concat(parts);
    parts.push(part.subarray(0, count));
    at += count;
  }
}

function chooseLane(sessions) {
  let entries;
  try {
    entries = readdirSync(sessions, { withFileTypes: true });
  } catch (error) {
    throw new Error(`${sessions}: ${error.code}; expected the folder of a workspace`);
  }
  const lanes = entries.filter((each) => each.isDirectory() && each.name !== 'archive').map((each) => each.name).sort();
  if (lanes.length === 1) return lanes[0];
  const own = hostname().replace(/[^A-Za-z0-9._-]/g, '-');
  if (lanes.includes(own)) return own;
  throw new Error(`${sessions}: lanes are ${lanes.join(', ') || '(none)'}; name one with --lane`);
}

function print(value) {
  process.stdout.write(`${JSON.stringify(value)}\n`);
}

async function printHash(workspace, lane, many) {
  const follower = new Follower(workspace, lane);
  const name = many ? { workspace } : {};
  try {
    for await (const _ of follower.read());
  } catch (error) {
    if (!(error instanceof Damage)) throw error;
    print({ ...name, ...follower.summary(), tail: 'damaged', damage: error.found });
    process.stderr.write(`${workspace}: ${error.message}\n`);
    return false;
  } finally {
    if (follower.file >= 0) closeSync(follower.file);
  }
  print({ ...name, ...follower.summary() });
  return true;
}

async function follow(workspace, lane, until) {
  const follower = new Follower(workspace, lane);
  for (;;) {
    const change = waitForChange(join(follower.sessions, follower.lane)); // before reading, so that nothing is missed
    for await (const record of follower.read()) {
      print(record);
      if (record.seq >= until) process.exit(0);
    }
    await change;
  }
}

/** Step 7. */
function waitForChange(folder) {
  return new Promise((resolve) => {
    const watcher = watch(folder, finish).on('error', () => {}); // the poll remains
    const timer = setTimeout(finish, POLL_MS);
    function finish() {
      clearTimeout(timer);
      watcher.close();
      resolve();
    }
  });
}

async function main() {
  const options = {
    hash: { type: 'boolean' },
    follow: { type: 'boolean' },
    lane: { type: 'string' },
    until: { type: 'string' },
  };
  const { values, positionals } = parseArgs({ options, allowPositionals: true });
  if (values.follow && !values.hash && positionals.length === 1)
    return follow(positionals[0], values.lane, Number(values.until ?? Infinity));
  if (!values.hash || values.follow || positionals.length === 0)
    throw new Error('usage: node follow.mjs WORKSPACE... --hash | WORKSPACE --follow [--until SEQ] [--lane NAME]');
  let isWhole = true;
  for (const each of positionals) isWhole = (await printHash(each, values.lane, positionals.length > 1)) && isWhole;
  process.exitCode = isWhole ? 0 : 1;
}

main().catch((error) => {
  process.stderr.write(`${error.message}\n`);
  process.exitCode = error instanceof Damage ? 1 : 2;
});
