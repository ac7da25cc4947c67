// Parses Mermaid diagrams with Mermaid itself. In: lines on standard input, each a JSON list of texts. Out: a line for
// each, a JSON list with {"type", "labels" and "edges" of a flowchart} or {"error"} of every text. Mermaid cleans labels
// with DOMPurify, which needs a document.

import { createInterface } from 'node:readline';
import { JSDOM } from 'jsdom';

const { window } = new JSDOM('');
Object.assign(globalThis, { window, document: window.document });
const { default: mermaid } = await import('mermaid');

async function parse(diagram) {
  try {
    await mermaid.parse(diagram);
    const { type, db } = await mermaid.mermaidAPI.getDiagramFromText(diagram);
    const labels = type.startsWith('flowchart') ? [...db.getVertices().values()].map((vertex) => vertex.text) : [];
    return { type, labels, edges: labels.length ? db.getEdges().length : 0 };
  } catch (error) {
    return { error: error.message };
  }
}

for await (const line of createInterface({ input: process.stdin })) {
  const answers = [];
  for (const diagram of JSON.parse(line)) answers.push(await parse(diagram));
  process.stdout.write(`${JSON.stringify(answers)}\n`);
}
window.close();
