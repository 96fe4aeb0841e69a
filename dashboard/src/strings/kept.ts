/** Words of the part of linear models that is read on demand: kept models, and pairs of groups. */
import { ownWords } from ".";

const n = (value: number, language: string): string => value.toLocaleString(language);

const en = {
  title: "Predict from this model",
  lead: "A kept model says what a shape looks like at any values, without its shapes. It is kept as long as its job: the last 1000 of them.",
  keep: "Keep this model",
  again: "Keep the model above instead",
  keeping: "The model is fitted and kept …",
  other: "What is kept is another model than the one above.",
  gone: "This model is no longer kept. Keep it again.",
  about: (formula: string, shapes: number) =>
    `${formula}, fitted to ${n(shapes, "en-GB")} ${shapes === 1 ? "shape" : "shapes"}.`,
  all: "all, as they occur",
  bands: "Bands",
  levels: { "": "none", "0.8": "80\u00a0%", "0.95": "95\u00a0%", "0.99": "99\u00a0%" } as Record<string, string>,
  mean: "Mean of all shapes",
  predicted: "Predicted",
  alt: (place: string) => `The shape predicted at ${place}, and the mean of all shapes`,
  caption: "Pale: the mean of all shapes. In front: the shape that the model predicts at the values of the sliders.",
  coloured: "Colours: where the predicted shape lies outside (red) or inside (blue) of the mean of all shapes.",
  together: (level: string, draws: number) =>
    `At ${level} the band holds all places of the mean shape at these values together, from ${n(draws, "en-GB")} draws of the residuals.`,
  single: (level: string) =>
    `At ${level} the extent of the band in each direction is the interval of each place of the mean shape by itself, at these values. For all places together the model has no draws: that takes at least 99 permutations, and shapes without blocks.`,
  outside:
    "Outside of the data: no shape has such values, and the prediction is a guess that the model makes from others.",
  undetermined:
    "The shapes do not say what one with these values looks like: none of them has this combination. Choose another one.",
  noBands: "A model with random parts has no bands.",
  leverage: (value: string) =>
    `Leverage ${value}: the variance of the prediction, as a part of that of one shape. The smaller, the surer.`,
  settings: "Values",
  none: "This formula has no attribute that can be set here.",
  pairs: "Groups beside each other",
  noPairs: "not compared",
  matrix: (factor: string) => `Pairs of ${factor}`,
  matrixHint: (permutations: string, reduced: string) =>
    `Above the diagonal: distances between the means of two groups, at equal values of everything else. Below: p after Holm's correction, from ${permutations} ${permutations === "1" ? "permutation" : "permutations"} of what the model ${reduced} leaves; bold where it is at most 0.05.`,
  ofPair: (first: string, second: string) => `${first} and ${second}`,
};

const de: typeof en = {
  title: "Vorhersagen mit diesem Modell",
  lead: "Ein behaltenes Modell sagt, wie eine Form bei beliebigen Werten aussieht, ohne seine Formen. Es bleibt, solange es seinen Auftrag gibt: die letzten 1000.",
  keep: "Dieses Modell behalten",
  again: "Stattdessen das Modell oben behalten",
  keeping: "Das Modell wird angepasst und behalten …",
  other: "Behalten ist ein anderes Modell als das oben.",
  gone: "Dieses Modell gibt es nicht mehr. Behalten Sie es neu.",
  about: (formula: string, shapes: number) =>
    `${formula}, angepasst an ${n(shapes, "de-DE")} ${shapes === 1 ? "Form" : "Formen"}.`,
  all: "alle, wie sie vorkommen",
  bands: "Bänder",
  levels: { "": "keine", "0.8": "80\u00a0%", "0.95": "95\u00a0%", "0.99": "99\u00a0%" },
  mean: "Mittel aller Formen",
  predicted: "Vorhergesagt",
  alt: (place: string) => `Die bei ${place} vorhergesagte Form und das Mittel aller Formen`,
  caption: "Blass: das Mittel aller Formen. Davor: die Form, die das Modell bei den Werten der Regler vorhersagt.",
  coloured: "Farben: wo die vorhergesagte Form außerhalb (rot) oder innerhalb (blau) des Mittels aller Formen liegt.",
  together: (level: string, draws: number) =>
    `Mit ${level} liegen alle Orte der mittleren Form bei diesen Werten zusammen im Band, nach ${n(draws, "de-DE")} Ziehungen der Reste.`,
  single: (level: string) =>
    `Mit ${level} ist die Ausdehnung des Bands in jeder Richtung das Intervall jedes Orts der mittleren Form für sich, bei diesen Werten. Für alle Orte zusammen hat das Modell keine Ziehungen: Dafür braucht es mindestens 99 Permutationen und Formen ohne Blöcke.`,
  outside:
    "Außerhalb der Daten: Keine Form hat solche Werte; die Vorhersage ist eine Vermutung, die das Modell aus anderen gewinnt.",
  undetermined:
    "Die Formen sagen nicht, wie eine mit diesen Werten aussieht: Keine von ihnen hat diese Kombination. Wählen Sie eine andere.",
  noBands: "Ein Modell mit zufälligen Teilen hat keine Bänder.",
  leverage: (value: string) =>
    `Hebelwert ${value}: die Varianz der Vorhersage als Teil der Varianz einer Form. Je kleiner, desto sicherer.`,
  settings: "Werte",
  none: "Diese Formel hat kein Merkmal, das hier gesetzt werden kann.",
  pairs: "Gruppen nebeneinander",
  noPairs: "nicht verglichen",
  matrix: (factor: string) => `Paare von ${factor}`,
  matrixHint: (permutations: string, reduced: string) =>
    `Über der Diagonale: Abstände der Mittel zweier Gruppen bei sonst gleichen Werten. Darunter: p nach Holms Korrektur, aus ${permutations} ${permutations === "1" ? "Permutation" : "Permutationen"} dessen, was das Modell ${reduced} übrig lässt; fett, wo es höchstens 0,05 ist.`,
  ofPair: (first: string, second: string) => `${first} und ${second}`,
};

/** The words in the language of the page. */
export const words = (): typeof en => ownWords({ en, de });
