/** A shape on its way from one view to another; it survives a reload of the tab. */
import type { Input } from "../formats/file";

const NAME = "shapelex.shape";
export function handOver(shapes: Input[]): void {
  sessionStorage.setItem(NAME, JSON.stringify(shapes));
}
export function handedOver(): Input[] {
  const text = sessionStorage.getItem(NAME);
  sessionStorage.removeItem(NAME);
  return text ? (JSON.parse(text) as Input[]) : [];
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
