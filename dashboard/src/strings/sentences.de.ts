/** Kinds of what files hold beside shapes, by the words of their readers. They stand before a number. */
export const KINDS: Record<string, string> = {
  "annotations that are not selected": "Annotationen, die nicht gewählt sind",
  "annotations without outline": "Annotationen ohne Umriss",
  "arrays of other than the vertices": "Felder, die nicht zu den Ecken gehören",
  "arrays of texts": "Felder aus Texten",
  "arrays of the whole file": "Felder der ganzen Datei",
  "arrays without components": "Felder ohne Komponenten",
  "attributes of an operating system": "Angaben eines Betriebssystems",
  "attributes of further rings of an object": "Merkmale weiterer Ringe eines Objekts",
  "attributes that are no text, number or Boolean": "Merkmale, die kein Text, keine Zahl und kein Wahrheitswert sind",
  "attributes that are not selected": "Merkmale, die nicht gewählt sind",
  "broken shapes": "Fehlerhafte Formen",
  "cells of points beside lines or polygons": "Zellen aus Punkten neben Linien oder Vielecken",
  "cells that are no polygons": "Zellen, die keine Vielecke sind",
  "chain codes and radii": "Kettencodes und Radien",
  "child objects": "Untergeordnete Objekte",
  "closed contours of fewer than three points": "Geschlossene Konturen aus weniger als drei Punkten",
  "colours of labels": "Farben von Labeln",
  columns: "Spalten",
  "columns of other files": "Spalten anderer Dateien",
  "columns of other types": "Spalten anderer Typen",
  "columns of transformations": "Spalten mit Abbildungen",
  comments: "Kommentare",
  curves: "Kurven",
  "domains that are not selected": "Bereiche, die nicht gewählt sind",
  "elements other than vertices and faces": "Elemente außer Ecken und Seitenflächen",
  "empty geometries": "Leere Geometrien",
  "empty regions": "Leere Regionen",
  "entries of metadata beside those of the points": "Einträge der Metadaten außer denen der Punkte",
  "entries of metadata, which may identify someone": "Einträge der Metadaten, die jemanden erkennbar machen können",
  "excluded subjects": "Ausgeschlossene Personen",
  "faces of less than three corners": "Seitenflächen mit weniger als drei Ecken",
  "faces of meshes whose vertices become landmarks": "Seitenflächen von Netzen, deren Ecken Landmarken werden",
  "facts that differ between files": "Angaben, die sich zwischen Dateien unterscheiden",
  "features that are not selected": "Features, die nicht gewählt sind",
  "features without geometry": "Features ohne Geometrie",
  "fields beyond the first thousand": "Felder nach den ersten tausend",
  "fields of cells without polygons": "Felder von Zellen ohne Vielecke",
  "fields of corners of faces of several sizes": "Felder an Ecken von Seitenflächen verschiedener Größe",
  "fields of meshes": "Felder von Netzen",
  "fields of points without faces": "Felder von Punkten ohne Seitenflächen",
  "files beside those that the project names": "Dateien außer denen, die das Projekt nennt",
  "files of no known format": "Dateien ohne bekanntes Format",
  "files of other names": "Dateien mit anderen Namen",
  holes: "Löcher",
  "identifying elements": "Elemente, die jemanden erkennbar machen",
  images: "Bilder",
  "keypoints beside polygons": "Schlüsselpunkte neben Vielecken",
  "labels of columns": "Beschriftungen von Spalten",
  landmarks: "Landmarken",
  "lines beside the faces": "Linien neben den Seitenflächen",
  "lists of several lengths": "Listen verschiedener Länge",
  "markups other than points and curves": "Markierungen außer Punkten und Kurven",
  "markups that are not selected": "Markierungen, die nicht gewählt sind",
  masks: "Masken",
  "measurements of markups": "Messungen an Markierungen",
  "measurements without a number": "Messungen ohne Zahl",
  "measures of points": "Maße von Punkten",
  "geometries that are not selected": "Geometrien, die nicht gewählt sind",
  "members of collections": "Einträge von Sammlungen",
  "members of features": "Einträge von Features",
  "members of geometries": "Einträge von Geometrien",
  "members with the name of a property": "Einträge mit dem Namen einer Eigenschaft",
  "metadata with the name of a member": "Metadaten mit dem Namen eines Eintrags",
  "normals of no face": "Normalen ohne Seitenfläche",
  "normals that are not in the file": "Normalen, die nicht in der Datei sind",
  "nuclei of cells": "Kerne von Zellen",
  "objects of vertices only, beside faces or lines": "Objekte nur aus Ecken, neben Seitenflächen oder Linien",
  "objects without a shape": "Objekte ohne Form",
  "outlines beside the nuclei": "Umrisse neben den Kernen",
  "pictures without labels": "Bilder ohne Label",
  "places of holes that follow no area": "Stellen von Löchern, die auf keine Fläche folgen",
  "point elements": "Punktelemente",
  "points and curves that are in no plane": "Punkte und Kurven, die in keiner Ebene liegen",
  "points and open curves beside a surface": "Punkte und offene Kurven neben einer Fläche",
  "points of no line": "Punkte ohne Linie",
  "points that repeat the first one": "Punkte, die den ersten wiederholen",
  "private elements": "Private Elemente",
  "properties with the name of a member": "Eigenschaften mit dem Namen eines Eintrags",
  "references to other files": "Verweise auf andere Dateien",
  "regions that are not selected": "Regionen, die nicht gewählt sind",
  "regions that make no surface": "Regionen, die keine Fläche ergeben",
  "regions without contours": "Regionen ohne Konturen",
  "regions without contours in parallel planes": "Regionen ohne Konturen in parallelen Ebenen",
  sections: "Abschnitte",
  "shapes without points": "Formen ohne Punkte",
  "smoothing groups": "Glättungsgruppen",
  "solids without triangles": "Körper ohne Dreiecke",
  "statements of display": "Anweisungen zur Darstellung",
  "statements of free-form curves and surfaces": "Anweisungen für Freiformkurven und -flächen",
  "subjects without such a file": "Personen ohne solche Datei",
  "tables of colours": "Farbtabellen",
  "texture coordinates of no face": "Texturkoordinaten ohne Seitenfläche",
  "texture coordinates that are not in the file": "Texturkoordinaten, die nicht in der Datei sind",
  texts: "Texte",
  "third texture coordinates": "Dritte Texturkoordinaten",
  "uncertainties of points": "Unsicherheiten von Punkten",
  "values that differ within a shape": "Werte, die sich innerhalb einer Form unterscheiden",
  "vertices of no face": "Ecken ohne Seitenfläche",
  "weights of vertices": "Gewichte von Ecken",
};

/**
 * Sentences of the service in German, by their form: what stands in parentheses is kept, numbers with a decimal comma. `$1` is a part as
 * it is, `$~1` a part that is a sentence of the service itself. The first form that fits counts. They are read when the first sentence
 * is shown. `tests/sentences.test.mjs` compares them with the sources of the service.
 */
export const SENTENCES: [RegExp, string][] = [
  // Warnings within others: of a file of an archive, a region, one of two bodies.
  [/^file '(.+?)': (.+)$/s, "Datei „$1“: $~2"],
  [/^region '(.+?)': (.+)$/s, "Region „$1“: $~2"],
  [/^\/first: (.+)$/s, "Der erste Körper: $~1"],
  [/^\/second: (.+)$/s, "Der zweite Körper: $~1"],

  // Login and selection.
  [/^expected the role (\w+), the caller has the role (\w+)$/, "Nötig ist die Rolle $1, angemeldet ist die Rolle $2."],
  [/^the filter selects no shapes?$/, "Keine Form erfüllt die Filter."],
  [/^External id already in use.*$/i, "Die Kennung gehört schon einer Form mit anderen Punkten."],
  [
    /^the external id '(.+)' belongs to another shape of the cohort, with other points$/,
    "Die Kennung „$1“ gehört schon einer anderen Form der Kohorte mit anderen Punkten.",
  ],
  [/^expected labels, got .*photograph.*$/i, "Das ist ein Foto und kein Bild aus Labels."],

  // Shapes of a cohort.
  [
    /^(\d+) of (\d+) contours run (?:clockwise|counter-clockwise), unlike the others.*$/,
    "$1 von $2 Konturen laufen anders herum als die anderen.",
  ],
  [
    /^(\d+) new contours run (?:clockwise|counter-clockwise), unlike the first one of the cohort.*$/,
    "$1 neue Konturen laufen anders herum als die erste der Kohorte.",
  ],
  [
    /^(\d+) of (\d+) contours run (?:clockwise|counter-clockwise), unlike the mean of the dictionary.*$/,
    "$1 von $2 Konturen laufen anders herum als das Mittel des Modells.",
  ],
  [
    /^(\d+) of (\d+) surfaces came as meshes, and parameters were computed for each by itself.*$/,
    "$1 von $2 Flächen kamen als Netze, jede mit eigenen Parametern: Gleiche Parameter sind nicht gleiche Orte. Bringen Sie sie erst in Übereinstimmung.",
  ],
  [
    /^the parameterisations of (\d+) of (\d+) surfaces that were looked at disagree with that of the mean.*$/,
    "Die Parameter von $1 von $2 geprüften Flächen passen nicht zu denen des Mittels, das dann kein Mittel ihrer Formen ist: Bringen Sie sie erst in Übereinstimmung.",
  ],
  [
    /^where (\d+) of (\d+) contours began is not known, since an earlier version has stored them.*$/,
    "Wo $1 von $2 Konturen begannen, ist nicht bekannt, weil eine frühere Version sie gespeichert hat: Die Bogenlänge wird von ihrem kanonischen Anfang an versucht.",
  ],
  [
    /^(\d+) of (\d+) surfaces are farther from their meshes than (\d+) % of their size in the mean, the worst by ([\d.]+) %.*$/,
    "$1 von $2 Flächen liegen im Mittel weiter als $3\u00a0% ihrer Größe neben ihren Netzen, die schlechteste $4\u00a0%: Wählen Sie mehr Kontrollpunkte.",
  ],
  [
    /^(\d+) of (\d+) surfaces fold over more than (\d+) % of their area.*$/,
    "$1 von $2 Flächen falten sich auf mehr als $3\u00a0% ihrer Fläche: Wählen Sie mehr Steifigkeit oder einen kleineren Grad.",
  ],
  [
    /^(\d+) of (\d+) surfaces are represented with an error of more than (\d+) % of their extent.*$/,
    "$1 von $2 Flächen sind mit einem Fehler von mehr als $3\u00a0% ihrer Ausdehnung dargestellt: Wählen Sie mehr Kontrollpunkte.",
  ],
  [
    /^(\d+) shapes stand in the cohort with the same points and other attributes or metadata, which stay as they are$/,
    "$1 Formen stehen mit denselben Punkten und anderen Merkmalen schon in der Kohorte; diese bleiben, wie sie sind.",
  ],
  [
    /^(\d+) shapes are of no patient whom the file identifies$/,
    "$1 Formen gehören zu keiner Person, die die Datei nennt.",
  ],
  [
    /^expected coordinates in (.+), the length unit of the cohort, got (.+?)([:;,.].*)?$/,
    "Die Koordinaten müssten in $1 sein, der Einheit der Kohorte, sie sind in $2.",
  ],
  [
    /^the cohort has shapes and no length unit: coordinates are stored in (.+), whatever those of the other shapes are in$/,
    "Die Kohorte hat Formen und keine Längeneinheit: Die Koordinaten werden in $1 gespeichert, in welcher Einheit auch immer die anderen Formen sind.",
  ],
  [
    /^the dictionary has no length unit: coordinates are taken in (.+), whatever those of its own shapes are in$/,
    "Das Modell hat keine Längeneinheit: Die Koordinaten gelten als $1, in welcher Einheit auch immer seine eigenen Formen sind.",
  ],
  [
    /^the cohort has (\d+) names of attributes, of which the first (\d+) have a column$/,
    "Die Kohorte hat $1 Namen von Merkmalen; die ersten $2 haben eine Spalte.",
  ],

  // Means, comparisons and regressions.
  [
    /^the (?:pooled )?mean is not unique: the eigenvalue gap is below (\S+) of the total weight$/,
    "Das Mittel ist nicht eindeutig: Der Abstand der Eigenwerte liegt unter $1 des ganzen Gewichts.",
  ],
  [
    /^the pooled mean has not converged after (\d+) rounds$/,
    "Das gemeinsame Mittel ist nach $1 Runden nicht zur Ruhe gekommen.",
  ],
  [
    /^no convergence after (\d+) rounds: the mean still changed in the last ones$/,
    "Nach $1 Runden hat sich das Mittel noch verändert.",
  ],
  [
    /^(\d+) of the shapes that count \((\d+) %\) are unlike the majority and agree with each other, and the mean is ([\d.]+) % of its size away.*$/,
    "$1 der Formen, die zählen ($2\u00a0%), sind anders als die Mehrheit und einander ähnlich; das Mittel liegt $3\u00a0% seiner Größe von dem der Mehrheit entfernt. Wenn sie von anderer Art sind, lassen Sie sie aus.",
  ],
  [
    /^the components are not centred: the first one is the mean.*$/,
    "Die Muster sind nicht zentriert: Das erste ist das Mittel, und die Anteile der Variation zählen es mit.",
  ],
  [/^sizes beyond (\S+) are not compared$/, "Größen über $1 werden nicht verglichen."],
  [
    /^the shapes of '(.+)' scatter ([\d.]+) times as much as those of '(.+)': the smaller group scatters more.*$/,
    "Die Formen von „$1“ streuen $2-mal so stark wie die von „$3“: Die kleinere Gruppe streut mehr, sodass alle Tests zu oft Unterschiede finden.",
  ],
  [
    /^the shapes of '(.+)' scatter ([\d.]+) times as much as those of '(.+)': the larger group scatters more.*$/,
    "Die Formen von „$1“ streuen $2-mal so stark wie die von „$3“: Die größere Gruppe streut mehr, sodass alle Tests zu selten Unterschiede finden.",
  ],
  [
    /^the shapes of '(.+)' scatter ([\d.]+) times as much as those of '(.+)':.*$/,
    "Die Formen von „$1“ streuen $2-mal so stark wie die von „$3“: Die Tests sind dann nicht ganz zuverlässig.",
  ],
  [
    /^the shapes of '(.+)' scatter, those of '(.+)' are equal.*$/,
    "Die Formen von „$1“ streuen, die von „$2“ sind gleich: Die Tests sind dann nicht ganz zuverlässig.",
  ],
  [
    /^shapes of '(.+)' scatter ([\d.]+) times as much as those of '(.+)' about the model, and the tests assume equal scatter: groups of equal size.*$/,
    "Die Formen von „$1“ streuen $2-mal so stark um das Modell wie die von „$3“; die Tests nehmen gleiche Streuung an. Gruppen gleicher Größe ertragen das gut.",
  ],
  [
    /^shapes of '(.+)' scatter ([\d.]+) times as much as those of '(.+)' about the model.*$/,
    "Die Formen von „$1“ streuen $2-mal so stark um das Modell wie die von „$3“; bei Gruppen ungleicher Größe finden die Tests zu oft oder zu selten Unterschiede.",
  ],
  [
    /^shapes of '(.+)' scatter unlike those of '(.+)' about the model.*$/,
    "Die Formen von „$1“ streuen anders um das Modell als die von „$2“; die Tests nehmen gleiche Streuung an.",
  ],
  [
    /^shapes above the median of the attribute scatter (?:([\d.]+) times as much as|unlike) those below it.*$/,
    "Formen über dem Median des Merkmals streuen stärker ($1) als die darunter: Der Test nimmt gleiche Streuung an und findet zu oft Änderungen.",
  ],
  [
    /^shapes below the median of the attribute scatter (?:([\d.]+) times as much as|unlike) those above it.*$/,
    "Formen unter dem Median des Merkmals streuen stärker ($1) als die darüber: Der Test nimmt gleiche Streuung an und findet zu oft Änderungen.",
  ],
  [
    /^(\d+) shapes are of (\d+) subjects: .*$/,
    "$1 Formen sind von $2 Personen: Formen einer Person sind nicht unabhängig, die p-Werte sind zu klein.",
  ],
  [
    /^(\d+) subjects have shapes in several groups.*$/,
    "$1 Personen haben Formen in mehreren Gruppen: Vertauschen Sie innerhalb der Personen.",
  ],
  [
    /^no labels of '(.+)' and '(.+)' can be exchanged within the strata: there is no p value$/,
    "Zwischen „$1“ und „$2“ lässt sich innerhalb der Schichten nichts vertauschen: Es gibt keinen p-Wert.",
  ],
  [
    /^(\d+) shapes (?:lack a value and|have no value of the attribute and) are left out$/,
    "$1 Formen ohne Wert sind ausgelassen.",
  ],
  [
    /^(\d+) shapes have no partner in another cohort and are left out$/,
    "$1 Formen ohne Partner in der anderen Kohorte sind ausgelassen.",
  ],
  [
    /^parts of one aligned shape share its alignment, which makes them covary.*$/,
    "Teile einer ausgerichteten Form teilen ihre Ausrichtung und variieren deshalb zusammen: Getrennte Ausrichtung nimmt das heraus.",
  ],
  [
    /^object symmetry exchanges shapes and their images as if they were independent.*$/,
    "Objektsymmetrie vertauscht Formen und ihre Spiegelbilder, als wären sie unabhängig: Auf der Stufe 5\u00a0% finden Individuen in 11\u00a0% der Nullfälle p ≤ 0,05.",
  ],
  [
    /^(.+) has too few distinct exchanges for a p value: expected at least (\d+)$/,
    "$1 hat zu wenige verschiedene Vertauschungen für einen p-Wert: Nötig sind mindestens $2.",
  ],
  [
    /^(.+) has (\S+) distinct exchanges, of at least (\S+) for a p value$/,
    "$1 hat $2 verschiedene Vertauschungen; für einen p-Wert sind mindestens $3 nötig.",
  ],

  // Linear models.
  [/^no shape has (.+) = (.+): left out$/, "Keine Form hat $1 = $2: ausgelassen."],
  [
    /^without an intercept, sums of squares and R² are those about zero$/,
    "Ohne Achsenabschnitt sind Quadratsummen und R² die um null.",
  ],
  [/^columns that depend on others are left out: (.+)$/, "Spalten, die von anderen abhängen, sind ausgelassen: $1."],
  [
    /^type III with other contrasts than sum tests effects at the reference level.*$/,
    "Typ III mit anderen Kontrasten als Summen prüft Wirkungen bei der Bezugsstufe, nicht um das Mittel von allen.",
  ],
  [
    /^terms that vary inside of random groups are tested by type II, given the groups$/,
    "Terme, die innerhalb zufälliger Gruppen variieren, sind nach Typ II geprüft, mit den Gruppen im Modell.",
  ],
  [/^random parts are not tested: (.+)$/s, "Zufällige Teile sind nicht geprüft: $~1"],
  [/^the random part is not estimated: (.+)$/s, "Der zufällige Teil ist nicht geschätzt: $~1"],
  [
    /^the variances of the random part have not converged$/,
    "Die Varianzen des zufälligen Teils sind nicht zur Ruhe gekommen.",
  ],
  [
    /^shapes of blocks are not independent: intervals and simultaneous bands are left out$/,
    "Formen von Blöcken sind nicht unabhängig: Intervalle und gemeinsame Bänder fehlen.",
  ],
  [
    /^(\d+) of (\d+) usual predictions are left out: the shapes do not determine them.*$/,
    "$1 von $2 üblichen Vorhersagen fehlen: Die Formen bestimmen sie nicht, weil Kombinationen von Stufen keine Formen haben.",
  ],
  [
    /^agreement and consistency need every replicate of every subject once, with equal weights$/,
    "Übereinstimmung und Beständigkeit brauchen jede Wiederholung jeder Person genau einmal, mit gleichen Gewichten.",
  ],
  [
    /^expected values that the shapes determine, got others.*$/,
    "Die Formen bestimmen nicht, wie eine mit diesen Werten aussieht: Keine hat diese Kombination.",
  ],
  [/^expected attributes of the shapes in the formula, got '(.+)'$/, "„$1“ ist kein Merkmal dieser Formen."],
  [
    /^expected a factor of at least two levels, got one for '(.+)': (.+)$/,
    "„$1“ hat nur eine Stufe ($2); nötig sind mindestens zwei.",
  ],
  [/^expected numbers that vary for '(.+)', got (.+) for all shapes$/, "„$1“ hat bei allen Formen den Wert $2."],
  [/^expected numbers for '(.+)', got texts$/, "„$1“ hat Texte; nötig sind Zahlen."],
  [
    /^expected at least (\d+) shapes for a design of rank (\d+), got (\d+): no degree of freedom is left$/,
    "Nötig sind mindestens $1 Formen für $2 Spalten, vorhanden sind $3: Es bleibt kein Freiheitsgrad.",
  ],
  [
    /^expected shapes in every combination of levels for type III, got none for (.+): ask for type II$/,
    "Typ III braucht Formen in jeder Kombination von Stufen; keine gibt es für $1. Wählen Sie Typ II.",
  ],

  // Dictionaries.
  [/^the dictionary has (\d+) modes$/, "Das Modell hat $1 Muster."],
  [/^(\d+) subjects: intervals from so few are too narrow$/, "$1 Personen: Intervalle aus so wenigen sind zu schmal."],
  [
    /^means over subjects do not weigh shapes; components do$/,
    "Mittel über Personen gewichten keine Formen; die Muster tun es.",
  ],
  [
    /^this dictionary has no measures of held-out shapes.*$/,
    "Dieses Modell hat keine Maße zurückgehaltener Formen: Ausreißer und Ränge beziehen sich auf die Formen, aus denen es gelernt ist; neue Formen gelten zu oft als ungewöhnlich. Lernen Sie es neu.",
  ],
  [
    /^parts of shapes are compared with whole held-out shapes, not with parts of them: .*$/,
    "Teile von Formen werden mit ganzen zurückgehaltenen Formen verglichen, nicht mit Teilen davon.",
  ],
  [
    /^(\d+) subjects are few for simultaneous bands at the level (\S+): .*$/,
    "$1 Personen sind wenige für gemeinsame Bänder auf der Stufe $2: Der Faktor beruht auf einer Annahme über ihre Verteilung.",
  ],
  [
    /^the search of a pose did not converge: see more of the shape$/,
    "Die Suche der Lage kam nicht zur Ruhe: Zeigen Sie mehr von der Form.",
  ],
  [/^(\d+) of (\d+) shapes are drawn: one of (\d+)$/, "$1 von $2 Formen sind gezeichnet: eine von $3."],
  [/^(\d+) shapes have no scores$/, "$1 Formen haben keine Werte."],

  // Warps and sliding.
  [
    /^the map folds: its determinant is not positive at (\d+) of (\d+) nodes of the grid around the reference$/,
    "Die Abbildung faltet sich an $1 von $2 Knoten des Gitters.",
  ],
  [
    /^(\d+) points lie beyond the grid around the reference, where the map is extrapolated$/,
    "$1 Punkte liegen außerhalb des Gitters, wo die Abbildung fortgesetzt ist.",
  ],
  [
    /^the iteration of gpagen does not converge: the consensus moved by (\S+) of its size in the last round.*$/,
    "Die Iteration von gpagen kommt nicht zur Ruhe: In der letzten Runde bewegte sich das Mittel um $1 seiner Größe; das Ergebnis hängt von der Reihenfolge der Formen ab.",
  ],
  [/^shapes have grown beyond unit size while they slid$/, "Beim Gleiten sind Formen über die Größe eins gewachsen."],
  [
    /^no convergence after (\d+) rounds: the consensus moved by (\S+) of its size in the last one$/,
    "Nach $1 Runden bewegte sich das Mittel noch um $2 seiner Größe.",
  ],
  [
    /^(\d+) displacements along curves are longer than the distance to the next point.*$/,
    "$1 Verschiebungen entlang von Kurven sind länger als der Abstand zum nächsten Punkt: Punkte gleiten auf Sehnen und können die Kurve verlassen haben.",
  ],

  // Segmentation and label images.
  [
    /^(\d+) of its cells, (\d+) %, are those of result (\d+) too$/,
    "$1 seiner Bildpunkte, $2\u00a0%, gehören auch zu Objekt $3.",
  ],
  [
    /^the shape (folded|left the image|collapsed) in stage (\d+): the shape before that stage is answered$/,
    "Die Kontur versagte in Stufe $2: Gezeigt ist die vor dieser Stufe.",
  ],
  [
    /^the term (\S+) is positive at the initial shape \((\S+)\), as for an object of the other polarity$/,
    "Der Anfang sieht aus wie ein Objekt mit vertauschtem Hell und Dunkel ($1: $2).",
  ],
  [
    /^the shape left its object: it has (\S+) times the size of its initial shape$/,
    "Die Kontur hat ihr Objekt verlassen: Sie ist $1-mal so groß wie ihr Anfang.",
  ],
  [
    /^the shape left its object: it does not contain the centre of its initial shape$/,
    "Die Kontur hat ihr Objekt verlassen: Sie enthält die Mitte ihres Anfangs nicht.",
  ],
  [
    /^the shape left its object: it has no cell of its initial shape$/,
    "Die Kontur hat ihr Objekt verlassen: Sie hat keinen Bildpunkt ihres Anfangs.",
  ],
  [
    /^the prior compares control points beyond the ends as they are extended$/,
    "Das Vorwissen vergleicht Kontrollpunkte jenseits der Enden, wie sie fortgesetzt sind.",
  ],
  [
    /^the initial shape does not have the (holes|cavities and handles) of its component \((\d+)\)$/,
    "Der Anfang hat die Löcher seines Objekts nicht ($2).",
  ],
  [/^(\d+) components had handles, which are filled$/, "$1 Objekte hatten Henkel; sie sind gefüllt."],
  [
    /^the file does not say where the volume of its segments ends along z.*$/,
    "Die Datei sagt nicht, wo das Volumen ihrer Segmente in z endet: Seiten der ersten und der letzten Schicht zählen nicht als Bildrand.",
  ],
  [
    /^the file gives no sizes of its voxels: they are taken for cubes of side 1$/,
    "Die Datei nennt keine Größen ihrer Voxel: Sie gelten als Würfel der Seite 1.",
  ],
  [
    /^the file gives no distance between its layers.*$/,
    "Die Datei nennt keinen Abstand ihrer Schichten: Er gilt als 1 mm, und die Einheit der Formen als unbekannt.",
  ],

  // Curves and meshes.
  [/^length is accurate to (\S+) only$/, "Die Länge ist nur auf $1 genau."],
  [
    /^symmetric_l2 and hausdorff are accurate to (\S+) only: .*$/,
    "symmetric_l2 und hausdorff sind nur auf $1 genau: Die Punkte sind von langen Stücken fast gleich weit entfernt.",
  ],
  [
    /^(\d+) edges of the mesh have no length: vertices coincide$/,
    "$1 Kanten des Netzes haben keine Länge: Ecken fallen zusammen.",
  ],
  [/^(\d+) of its edges have no length: vertices coincide$/, "$1 Kanten haben keine Länge: Ecken fallen zusammen."],
  [/^all vertices coincide: the body encloses nothing$/, "Alle Ecken fallen zusammen: Der Körper umschließt nichts."],
  [/^all of its vertices are one point$/, "Alle Ecken sind ein Punkt."],
  [
    /^it is flat: it lies in a plane and encloses no volume$/,
    "Das Netz ist flach: Es liegt in einer Ebene und umschließt kein Volumen.",
  ],
  [
    /^it encloses no volume: its sheets coincide or cancel$/,
    "Das Netz umschließt kein Volumen: Seine Blätter fallen zusammen oder heben sich auf.",
  ],
  [
    /^it is inside out: its volume is negative.*$/,
    "Das Netz ist umgestülpt: Sein Volumen ist negativ, weil seine Flächen von außen im Uhrzeigersinn laufen.",
  ],
  [
    /^it crosses or lies on itself: volumes count some parts twice or not at all$/,
    "Das Netz kreuzt oder berührt sich: Volumen zählen manche Teile zweimal oder gar nicht.",
  ],
  [
    /^it is so far from the origin that coordinates are rounded to (\S+): smaller details are lost$/,
    "Es liegt so weit vom Ursprung, dass Koordinaten auf $1 gerundet sind: Kleinere Einzelheiten gehen verloren.",
  ],
  [
    /^the contour crosses or touches itself: areas with the winding number zero count as outside$/,
    "Die Kontur kreuzt oder berührt sich: Bereiche mit der Windungszahl null zählen als außen.",
  ],
  [/^parts of it beyond the grid are left out$/, "Teile außerhalb des Gitters sind ausgelassen."],
  [
    /^the normal of point (\d+) lies on the other side of one of its edges than the others do.*$/,
    "Die Normale von Punkt $1 liegt auf der anderen Seite einer Kante als die übrigen: Die Kurve hat dort eine Spitze.",
  ],
  [
    /^corners: (\d+) edges have a normal orthogonal to them at one end only.*$/,
    "$1 Kanten haben nur an einem Ende eine Normale senkrecht zu sich: Dort hat die Grenzfläche eine Ecke.",
  ],
  [
    /^the generator does not reproduce constants: moving the control points does not move the shape$/,
    "Der Generator gibt Konstanten nicht wieder: Wer die Kontrollpunkte verschiebt, verschiebt die Form nicht.",
  ],
  [
    /^the weights cancel: their system has the condition number (\S+)$/,
    "Die Gewichte heben sich auf: Ihr System hat die Kondition $1.",
  ],
  [
    /^the shifts are nearly dependent: A²\/B² is (\S+), control points may lie far from the curve$/,
    "Die Verschiebungen sind fast abhängig (A²/B² ist $1): Kontrollpunkte können weit neben der Kurve liegen.",
  ],

  // Files.
  [/^points without faces are read as landmarks$/, "Punkte ohne Flächen sind als Landmarken gelesen."],
  [/^polygons are fans of triangles$/, "Vielecke sind Fächer aus Dreiecken."],
  [
    /^(?:(\d+) )?coordinates are rounded to single precision$/,
    "$1 Koordinaten sind auf einfache Genauigkeit gerundet.",
  ],
  [
    /^the coordinate system of shapes is unknown: LPS is written$/,
    "Das Koordinatensystem der Formen ist unbekannt: LPS ist geschrieben.",
  ],
  [
    /^(\d+) masks are not read: .*$/,
    "$1 Masken sind nicht gelesen: Machen Sie Labelbilder daraus, und laden Sie diese hoch.",
  ],
  [
    /^(\d+) shapes in (.+) are written with the same numbers, which the format takes for (.+)$/,
    "$1 Formen in $2 sind mit denselben Zahlen geschrieben, die das Format für $3 hält.",
  ],
  [/^(\d+) shapes have no name: written with their number$/, "$1 Formen ohne Namen haben ihre Nummer."],
  [
    /^(\d+) shapes have more than (\d+) harmonics; the rest is at most (\S+) of the squared size of one$/,
    "$1 Formen haben mehr als $2 Harmonische; der Rest ist höchstens $3 der quadrierten Größe von einer.",
  ],
  [
    /^(\d+) shapes have further harmonics; these have at most (\S+) of the harmonic power of one$/,
    "$1 Formen haben weitere Harmonische mit höchstens $2 der Leistung von einer.",
  ],
  [
    /^(\d+) chain codes do not return to their start: open curves, unless closed is true$/,
    "$1 Kettencodes kehren nicht zu ihrem Anfang zurück: Es sind offene Kurven, außer „closed“ ist gesetzt.",
  ],
  [
    /^(\d+) features have NaN or Infinity, which is no JSON, taken as null$/,
    "$1 Objekte haben NaN oder Infinity, was kein JSON ist; es gilt als leer.",
  ],
  [
    /^(\d+) rings do not repeat their first point, taken as closed$/,
    "$1 Ringe wiederholen ihren ersten Punkt nicht; sie gelten als geschlossen.",
  ],
  [
    /^(\d+) contours are in the plane of no image of the series and refer to none$/,
    "$1 Konturen liegen in der Ebene keines Bildes der Serie und verweisen auf keines.",
  ],
  [/^the regions have several frames of reference$/, "Die Regionen haben mehrere Bezugssysteme."],
  [/^no region has a name that '(.+)' selects$/, "Keine Region hat einen Namen, den „$1“ auswählt."],
  [
    /^its contours are not in parallel planes \(a point is (\S+) mm from that of its contour\).*$/,
    "Die Konturen liegen nicht in parallelen Ebenen (ein Punkt ist $1 mm von der seiner Kontur entfernt); Schichten werden nicht unterschieden.",
  ],
  [
    /^its slices are (\S+) to (\S+) mm apart; gaps are bridged like others$/,
    "Die Schichten sind $1 bis $2 mm voneinander entfernt; Lücken werden überbrückt wie andere.",
  ],
  [
    /^(\d+) slices have several contours, which are records of their own$/,
    "$1 Schichten haben mehrere Konturen; jede ist eine Form für sich.",
  ],
  [
    /^(\d+) contours of type CLOSED_PLANAR lie within another one and are taken for holes$/,
    "$1 geschlossene Konturen liegen in einer anderen und gelten als Löcher.",
  ],
  [
    /^(\d+) contours run along a channel in both directions \(keyholes\); their holes are not cut out$/,
    "$1 Konturen laufen in beiden Richtungen durch einen Kanal; ihre Löcher sind nicht ausgeschnitten.",
  ],
  [/^(\d+) contours touch themselves$/, "$1 Konturen berühren sich."],
  [/^region '(.+)' makes no surface: (.+)$/s, "Region „$1“ ergibt keine Fläche: $~2"],
  [
    /^ImageJ draws a spline through the points, which are given as they are$/,
    "ImageJ zeichnet einen Spline durch die Punkte; sie sind so gegeben, wie sie sind.",
  ],
  [
    /^(\d+) points have only negative coordinates, and no other point has one.*$/,
    "$1 Punkte haben nur negative Koordinaten, kein anderer Punkt hat eine: Wenn sie fehlen, sagen Sie es mit der Option „missing“.",
  ],
  [
    /^(\d+) of (\d+) specimens have SCALE=: coordinates are those of the file; the first without begins in line (\d+)$/,
    "$1 von $2 Exemplaren haben SCALE=: Die Koordinaten sind die der Datei; das erste ohne beginnt in Zeile $3.",
  ],
  [
    /^texts with bytes above 127, but no character set .*: (\d+), the first one at (.+?); .*$/,
    "$1 Texte mit Zeichen über 127 ohne passenden Zeichensatz, der erste bei $2: Sie können falsch gelesen sein.",
  ],

  // What files hold beside shapes, which may be counted by the size of its parts.
  ...Object.entries(KINDS).map(([what, own]): [RegExp, string] => [new RegExp(`^${what}$`), own]),
  [/^components of fewer than (\d+) cells$/, "Teile aus weniger als $1 Zellen"],
  [
    /^components of fewer than (\d+) cells or beside the largest of their label$/,
    "Teile aus weniger als $1 Zellen oder neben dem größten ihres Labels",
  ],

  // Forms that many refusals have.
  [/^expected (\d+) points?.*, got (\d+)$/, "Erwartet: $1 Punkte. Vorhanden: $2."],
  [/^expected at least (\d+) (?:shapes|points)?.*, got (\d+)$/, "Erwartet: mindestens $1. Vorhanden: $2."],
  [/^expected (.+), got (.+)$/s, "Erwartet: $1. Vorhanden: $2."],
];
