/** Tables for spreadsheets that write decimal commas: semicolons between fields, commas in numbers, and a mark that the text is UTF-8. */

/** Fields of the rows of a table (RFC 4180). */
export function fieldsOf(text: string): string[][] {
  const rows: string[][] = [[]];
  let field = "",
    quoted = false;
  for (let at = 0; at < text.length; at++) {
    const letter = text[at]!;
    if (quoted) {
      if (letter !== '"') field += letter;
      else if (text[at + 1] === '"') {
        field += '"';
        at++;
      } else quoted = false;
    } else if (letter === '"') quoted = true;
    else if (letter === "," || letter === "\n") {
      rows[rows.length - 1]!.push(field.replace(/\r$/, ""));
      field = "";
      if (letter === "\n") rows.push([]);
    } else field += letter;
  }
  if (field || rows[rows.length - 1]!.length) rows[rows.length - 1]!.push(field);
  return rows.filter((row) => row.length > 0);
}

const NUMBER = /^-?\d*\.?\d+(e[+-]?\d+)?$/i;
const written = (field: string): string => {
  const text = NUMBER.test(field) ? field.replace(".", ",") : field;
  return /[";\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

export const withCommas = (text: string): string =>
  `\uFEFF${fieldsOf(text)
    .map((row) => row.map(written).join(";"))
    .join("\r\n")}\r\n`;
