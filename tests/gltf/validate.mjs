// Reads paths of GLB files, one a line, and writes what the validator of glTF finds in each: {path: [{code, severity, pointer}]}.
import { readFileSync } from 'node:fs';
import validator from 'gltf-validator';

const found = {};
for (const path of readFileSync(0, 'utf8').split('\n').filter(Boolean)) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), { maxIssues: 0 });
  found[path] = report.issues.messages.map(({ code, severity, pointer }) => ({ code, severity, pointer: pointer ?? '' }));
}
console.log(JSON.stringify(found));
