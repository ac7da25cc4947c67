// One GGUF model behind `/chat/completions` on loopback, for tests: as much of the interface as a chat with a JSON schema
// needs. Prints its port.
//   node language_model.mjs FOLDER: node_modules and model.gguf are there
import http from "node:http";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [folder] = process.argv.slice(2);
const { resolve } = createRequire(`${folder}/`);
const { getLlama, LlamaChatSession } = await import(pathToFileURL(resolve("node-llama-cpp")));
const llama = await getLlama({ gpu: false, build: "never", maxThreads: 1 });
const model = await llama.loadModel({ modelPath: `${folder}/model.gguf` });
const context = await model.createContext({ contextSize: 4096 });

async function answer({ messages, max_tokens, response_format }, signal) {
  const sequence = context.getSequence();
  const session = new LlamaChatSession({ contextSequence: sequence });
  const [system, ...rest] = messages;
  const history = rest.slice(0, -1).map(({ role, content }) =>
    role === "user" ? { type: "user", text: content } : { type: "model", response: [content] });
  session.setChatHistory([{ type: "system", text: system.content }, ...history]);
  const schema = response_format?.json_schema?.schema;
  if (schema?.anyOf) { // the grammar knows it by another name, and not beside `type`
    schema.oneOf = schema.anyOf;
    delete schema.anyOf;
    delete schema.type;
  }
  const grammar = schema && (await llama.createGrammarForJsonSchema(schema));
  try {
    return await session.prompt(rest.at(-1).content, { grammar, maxTokens: max_tokens, temperature: 0, signal });
  } finally {
    session.dispose();
    sequence.dispose();
  }
}

let waiting = Promise.resolve(); // one request after the other: one context
const server = http.createServer(async (request, response) => {
  let body = "";
  for await (const part of request) body += part;
  const left = new AbortController(); // a client that waits no longer needs no answer
  response.on("close", () => left.abort());
  waiting = waiting.then(async () => {
    try {
      const content = await answer(JSON.parse(body), left.signal);
      response.end(JSON.stringify({ choices: [{ message: { role: "assistant", content } }] }));
    } catch (error) {
      response.writeHead(500).end(JSON.stringify({ error: { message: String(error) } }));
    }
  });
});
server.listen(0, "127.0.0.1", () => console.log(server.address().port));
