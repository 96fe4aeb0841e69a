/** Words of deformation grids, which are read on demand. */
import { ownWords } from ".";

const en = {
  title: "Deformation",
  lead: "What takes one shape to the other, as a grid that is bent with it: where its cells grow, the shape grows.",
  draw: "Draw the grid",
  hide: "Hide it",
  show: "Drawn as",
  views: { grid: "Grid", arrows: "Arrows", wireframe: "Both shapes" } as Record<string, string>,
  from: "From",
  to: "To",
  swap: "Swap",
  magnify: "Magnified",
  mean: "Mean of the cohort",
  same: "Choose two different shapes.",
  alt: (from: string, to: string) => `The deformation of ${from} into ${to}`,
  captions: {
    grid: (from: string, to: string) =>
      `A square grid around ${from}, bent by the thin-plate spline that takes it to ${to}.`,
    arrows: (from: string, to: string) => `Pale: ${from}. Arrows lead to the places of ${to}.`,
    wireframe: (from: string, to: string) => `Pale: ${from}. In front: ${to}.`,
  } as Record<string, (from: string, to: string) => string>,
  magnified: (times: string) => `Changes are shown ${times} times as large as they are.`,
  superimposed: (name: string) => `${name} was moved, turned and scaled onto the other shape first.`,
  folds: (some: string, all: string) =>
    `The grid folds over itself at ${some} of ${all} nodes (red): the shapes are too far apart for one smooth deformation there. Read the other parts only, or magnify less.`,
  energy: (value: string) => `Bending energy ${value}; 0 for shapes that differ by a linear map only.`,
  space: "In space the service draws the grid in two planes through the mean of the landmarks: x, y and x, z.",
};

const de: typeof en = {
  title: "Verformung",
  lead: "Was die eine Form in die andere überführt, als Gitter, das mit ihr verbogen wird: Wo seine Zellen wachsen, wächst die Form.",
  draw: "Gitter zeichnen",
  hide: "Ausblenden",
  show: "Gezeichnet als",
  views: { grid: "Gitter", arrows: "Pfeile", wireframe: "Beide Formen" },
  from: "Von",
  to: "Nach",
  swap: "Tauschen",
  magnify: "Vergrößert",
  mean: "Mittel der Kohorte",
  same: "Wählen Sie zwei verschiedene Formen.",
  alt: (from, to) => `Die Verformung von ${from} in ${to}`,
  captions: {
    grid: (from, to) =>
      `Ein quadratisches Gitter um ${from}, verbogen durch den Dünnplatten-Spline, der es in ${to} überführt.`,
    arrows: (from, to) => `Blass: ${from}. Pfeile führen zu den Orten von ${to}.`,
    wireframe: (from, to) => `Blass: ${from}. Davor: ${to}.`,
  },
  magnified: (times) => `Änderungen sind ${times}-mal so groß gezeigt, wie sie sind.`,
  superimposed: (name) => `${name} wurde zuerst auf die andere Form geschoben, gedreht und skaliert.`,
  folds: (some, all) =>
    `Das Gitter faltet sich an ${some} von ${all} Knoten (rot): Dort sind die Formen zu verschieden für eine glatte Verformung. Lesen Sie nur die anderen Teile, oder vergrößern Sie weniger.`,
  energy: (value) => `Biegeenergie ${value}; 0, wenn sich die Formen nur durch eine lineare Abbildung unterscheiden.`,
  space: "Im Raum zeichnet der Dienst das Gitter in zwei Ebenen durch das Mittel der Landmarken: x, y und x, z.",
};

/** The words in the language of the page. */
export const words = (): typeof en => ownWords({ en, de });
