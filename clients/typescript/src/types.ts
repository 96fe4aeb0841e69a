/** Types of requests and answers, from those of the OpenAPI document. */
import type { components, paths } from "../schema.js";

export type { components, operations, paths } from "../schema.js";

/** The schemas of the document, by name. */
export type Schemas = components["schemas"];
export type Method = "get" | "post" | "put" | "patch" | "delete";
/** The paths that have a method. */
export type PathsWith<M extends Method> = {
  [P in keyof paths]: paths[P] extends { [K in M]: object } ? P : never;
}[keyof paths] &
  string;
/** An operation of the document. */
export type Operation<M extends Method, P extends keyof paths> = paths[P][M & keyof paths[P]];

type Json = "application/json";
type Lines = "application/x-ndjson";
/** Any form that the service answers in: the answer is the bytes. */
type Any = "*/*";
type Text = `text/${string}` | "image/svg+xml";

type Good = 200 | 201 | 202;
/** Media types of the good answers with their content. */
type Contents<O> = O extends { responses: infer R }
  ? { [S in keyof R & Good]: R[S] extends { content: infer C } ? C : never }[keyof R & Good]
  : never;
type KeysOf<C> = C extends C ? keyof C & string : never;
type Of<C, A extends string> = C extends { [K in A]: infer T } ? T : never;
type JobOf<O> = O extends { responses: { 202: { content: infer C } } } ? Of<C, Json> : never;
/** A line as the document describes it, where it does not call it a text. */
type Line<T> = T extends string | Blob ? unknown : T;

/** Media types that an operation answers in, and `*` + `/*`. */
export type MediaType<O> = KeysOf<Contents<O>> | Any;
/** JSON, where an operation answers in JSON. */
export type DefaultMediaType<O> = Json extends MediaType<O> ? Json : MediaType<O>;

/**
 * What an operation answers, by media type: JSON as its value, NDJSON as its values one after the other, texts and SVG as a string,
 * anything else as bytes; a job in place of any of them where the document says so.
 */
export type Answer<O, A extends string = DefaultMediaType<O>> = [Contents<O>] extends [never]
  ? undefined
  : A extends Json
    ? Of<Contents<O>, Json>
    :
        | JobOf<O>
        | (A extends Lines ? AsyncGenerator<Line<Of<Contents<O>, A>>, void> : A extends Text ? string : ArrayBuffer);

/** A body that is a file, or the text of one. */
export type Raw = Blob | ArrayBuffer | ArrayBufferView | ReadableStream<Uint8Array> | string;
type Bodies<O> = O extends { requestBody?: infer B }
  ? NonNullable<B> extends { content: infer C }
    ? C
    : never
  : never;
/** JSON as an operation takes it. */
export type JsonBody<O> = Of<Bodies<O>, Json>;
/** JSON, the parts of a form, or a file, as an operation takes them. */
export type Body<O> = {
  [T in KeysOf<Bodies<O>>]: T extends Json | "multipart/form-data" ? Of<Bodies<O>, T> : Raw;
}[KeysOf<Bodies<O>>];
type RawType<O> = Exclude<KeysOf<Bodies<O>>, Json | "multipart/form-data">;

type Plain = string | number | boolean;
/** Conditions by attribute: a value, or operators with values, such as `{ age: { gte: 30 } }`. */
export type Conditions = { [name: string]: Plain | { [operator: string]: Plain } | null | undefined };
/** Parameters of a query. Lists repeat a name; null and undefined are left out. */
export type Query = { [name: string]: Plain | readonly Plain[] | Conditions | null | undefined };
type Values<T> = T extends readonly (infer E)[] ? readonly E[] : T extends object ? Conditions : T;
/** Another media type is asked for by `accept`; a `format` that has none, by its name with `accept: "*" + "/*"`. */
type Asked<T, A> = {
  [K in keyof T]: K extends "format" ? (A extends Any ? T[K] : undefined) : Values<T[K]> | null;
};

type PathPart<O> = O extends { parameters: { path: infer T } } ? { path: T } : { path?: undefined };
type QueryPart<O, A> = O extends { parameters: { query: infer T } }
  ? { query: Asked<T, A> }
  : O extends { parameters: { query?: infer T } }
    ? { query?: Asked<NonNullable<T>, A> }
    : { query?: undefined };
type BodyPart<O> = [Body<O>] extends [never]
  ? { body?: undefined }
  : { body: Body<O> } & ([RawType<O>] extends [never]
      ? unknown
      : {
          /** Media type of a body that is a file. Default: `application/octet-stream`, whose format the service finds. */
          contentType?: RawType<O> | (string & {});
          /** Further parameters of the query beside a file: fields of the JSON body, and options of reading. */
          options?: Record<string, unknown>;
        });
/** The document names no headers of many operations; the others, such as `if-none-match`, are taken by all. */
type HeaderPart<O> = O extends { parameters: { header?: infer T } }
  ? { headers?: ([NonNullable<T>] extends [never] ? unknown : Partial<NonNullable<T>>) & Headed }
  : { headers?: Headed };
type Headed = { [name: string]: string | number | null | undefined };
type AcceptPart<O, A> =
  Json extends MediaType<O> ? { accept?: A } : [Contents<O>] extends [never] ? { accept?: A } : { accept: A };

/** What every request may have besides. */
export interface Common {
  signal?: AbortSignal;
  /** Sees the answer before its body is read: its headers, such as `etag`. */
  onResponse?: (response: Response) => void;
}
/** All that an operation takes, `A` being the media type of the answer. */
export type Options<O, A extends string = DefaultMediaType<O>> = Common &
  PathPart<O> &
  QueryPart<O, A> &
  BodyPart<O> &
  HeaderPart<O> &
  AcceptPart<O, A>;
