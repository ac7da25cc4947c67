// Parses Mermaid diagrams with Mermaid itself. In: a JSON list of texts on standard input. Out: a JSON list, for each
// text {"type", "labels" and "edges" of a flowchart} or {"error"}. Mermaid cleans labels with DOMPurify, which needs a
// document.

import { text } from 'node:stream/consumers';
import { JSDOM } from 'jsdom';

const { window } = new JSDOM('');
Object.assign(globalThis, { window, document: window.document });
const { default: mermaid } = await import('mermaid');

const answers = [];
for (const diagram of JSON.parse(await text(process.stdin))) {
  try {
    await mermaid.parse(diagram);
    const { type, db } = await mermaid.mermaidAPI.getDiagramFromText(diagram);
    const labels = type.startsWith('flowchart') ? [...db.getVertices().values()].map((vertex) => vertex.text) : [];
    answers.push({ type, labels, edges: labels.length ? db.getEdges().length : 0 });
  } catch (error) {
    answers.push({ error: error.message });
  }
}
process.stdout.write(`${JSON.stringify(answers)}\n`);
window.close();
