// Foxglove's own schemas, as its package has them, and what is sent in their name held to them.

import { createRequire } from 'node:module';
import { assert, need } from './support.mjs';

const official = createRequire(`${need('PLUMBLINE_MODULES')}/`)('@foxglove/schemas/jsonschema');

/** A value is what a schema says, with all that it asks for and nothing beside. */
function holds(value, schema, at) {
  if (schema.oneOf) return assert(schema.oneOf.some((one) => one.const === value), `${at} is ${value}`);
  const type = Array.isArray(value) ? 'array' : Number.isInteger(value) && schema.type === 'integer' ? 'integer' : typeof value;
  assert(type === schema.type, `${at} is of type ${type}, not ${schema.type}`);
  if (type === 'array') return value.forEach((item, n) => holds(item, schema.items, `${at}[${n}]`));
  if (type !== 'object') return undefined;
  (schema.required ?? []).forEach((name) => assert(name in value, `${at} has no ${name}`));
  return Object.entries(value).forEach(([name, inner]) => {
    assert(schema.properties[name], `${at} has ${name}, which the schema has not`);
    holds(inner, schema.properties[name], `${at}.${name}`);
  });
}

/** A schema says nothing else than the official one. Foxglove refuses a channel where an object has no `properties`. */
function says(own, schema, at) {
  const type = schema.oneOf ? 'integer' : schema.type;
  assert(own.type === type, `${at} is said to be ${own.type}, not ${type}`);
  if (type === 'array') return says(own.items, schema.items, `${at}[]`);
  if (type !== 'object') return undefined;
  assert(own.properties, `${at} has no properties`);
  return Object.entries(own.properties).forEach(([name, inner]) => {
    assert(schema.properties[name], `${at} is said to have ${name}`);
    says(inner, schema.properties[name], `${at}.${name}`);
  });
}

/** What a channel says of its messages, and one of them, agree with the schema of that name. */
export function agrees(name, schema, message) {
  const known = official[name.replace('foxglove.', '')];
  assert(known, `Foxglove has no schema ${name}`);
  says(JSON.parse(schema), known, name);
  holds(JSON.parse(message), known, name);
}
