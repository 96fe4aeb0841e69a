/** A shape on its way from one view to another; it survives a reload of the tab. */
import type { Input } from "../formats/file";

const NAME = "shapelex.shape";
interface Handed {
  shapes: Input[];
  /** Unit of their coordinates, where it is known. */
  unit?: string;
}
export function handOver(handed: Handed): void {
  sessionStorage.setItem(NAME, JSON.stringify(handed));
}
export function handedOver(): Handed {
  const text = sessionStorage.getItem(NAME);
  sessionStorage.removeItem(NAME);
  return text ? (JSON.parse(text) as Handed) : { shapes: [] };
}

let image: File | undefined;
/** A picture on its way to be segmented; it does not survive a reload. */
export function handOverImage(file: File): void {
  image = file;
}
export function handedOverImage(): File | undefined {
  const file = image;
  image = undefined;
  return file;
}
