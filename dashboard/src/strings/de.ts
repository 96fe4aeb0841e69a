/** Alle Wörter auf Deutsch, in der Gestalt von `en.ts`. */
import type { Strings } from ".";

export const de: Strings = {
  frame: {
    menu: "Menü", crumbs: "Pfad", skip: "Zum Inhalt", language: "Sprache", theme: "Farben", auto: "Auto", light: "Hell", dark: "Dunkel",
    licences: "Lizenzen der Seite", loading: "Wird geladen", missing: "Seite nicht gefunden", missingHint: "Unter dieser Adresse gibt es keine Ansicht.",
  },
  menu: {
    start: "Start", cohorts: "Kohorten", dictionaries: "Wörterbücher", assess: "Beurteilen", segment: "Segmentieren", jobs: "Aufträge", console: "Konsole",
    administration: "Verwaltung", reference: "API-Referenz", single: "Einzelne Form", service: "Dienst",
  },
  act: {
    again: "Erneut versuchen", download: "Herunterladen", undo: "Rückgängig", undone: "Rückgängig gemacht.", close: "Schließen", copy: "Kopieren", copied: "Kopiert", cancel: "Abbrechen", create: "Anlegen", save: "Speichern",
    saved: "Gespeichert.", remove: "Löschen", change: "Bearbeiten", previous: "Zurück", next: "Weiter", less: "Weniger anzeigen", more: (count) => `${count} weitere anzeigen`, export: "Exportieren",
  },
  words: {
    name: "Name", description: "Beschreibung", kind: "Art", shape: "Form", shapes: "Formen", revision: "Revision", changed: "Letzte Änderung", created: "Angelegt", unit: "Längeneinheit", dimension: "Dimension",
    topology: "Topologie", yes: "ja", no: "nein", none: "keine", weight: "Gewicht", id: "Kennung", distance: "Abstand", cohort: "Kohorte", method: "Verfahren", version: "Version", component: "Komponente", rank: "Rang", dictionary: "Wörterbuch",
  },
  fault: {
    connection: "Der Dienst ist nicht erreichbar", connectionHint: "Die Verbindung ist abgerissen, oder der Dienst läuft nicht mehr. Diese Seite hat nichts verändert; versuchen Sie es erneut, sobald er wieder da ist.",
    line: (line) => `Zeile ${line}`, shape: (place) => `Form ${place}`, more: (count) => `und ${count} weitere`, request: "Anfrage",
  },
  login: {
    title: "Dieser Dienst verlangt einen Schlüssel", lead: "Fügen Sie den Schlüssel ein, den die Verwaltung für Sie angelegt hat. Er bestimmt, was Sie sehen und ändern dürfen.", key: "Schlüssel", enter: "Weiter",
    wrong: "Dieser Schlüssel gilt nicht", wrongHint: "Er ist falsch geschrieben, abgelaufen oder widerrufen. Bitten Sie die Verwaltung um einen neuen.", leave: "Schlüssel vergessen",
    where: "Der Schlüssel bleibt in diesem Tab, bis Sie ihn schließen. Er wird nur an diesen Dienst gesendet und ist nie Teil einer Adresse.",
  },
  start: {
    title: "Formen und ihre Unterschiede", lead: "Shapelex richtet Umrisse und Flächen aneinander aus, findet ihr Mittel und die Richtungen, in denen sie variieren, und sagt, ob eine neue Form dazu passt. Eine Vorlage wählt niemand von Hand.",
    cohorts: "Kohorten", shapes: "Formen", dictionaries: "Wörterbücher", running: "Laufende Aufträge", version: "Version", empty: "Es gibt noch keine Kohorte. Legen Sie eine an und ziehen Sie dann Dateien mit Konturen darauf.",
    example: "Die Beispielkohorte", exampleCaption: (count) => `Die Umrisse von ${count} Mauszellen, verschoben, gedreht und skaliert, bis sie aufeinanderliegen; davor ihr Mittel.`,
    tour: "Ein Rundgang in fünf Schritten",
    steps: [
      ["Die Zellen ansehen", "Alle Umrisse in einem Maßstab, mit Filtern nach Zelllinie, Behandlung und Größe."], ["Ihr Mittel sehen", "Wählen Sie, welche Unterschiede nicht zählen: Lage, Größe, Drehung, Scherung."],
      ["Lernen, wie sie variieren", "Zehn Komponenten der Kohorte, in einer Sekunde; dann bewegen Sie die Regler."], ["Eine Zelle beurteilen", "Die wahrscheinlichste Behandlung, ob die Zelle ungewöhnlich ist und wo sie abweicht."],
      ["Behandlungen vergleichen", "Unterscheiden sie sich, wie stark und wo? Mit einem Permutationstest."],
    ],
    toCohorts: "Mengen von Formen mit Merkmalen, Maßen und Mitteln.", toAssess: "Kontur oder Maske ablegen; einen Bericht von einer Seite drucken.", toSegment: "Den Umriss eines Objekts in einem Bild finden.",
  },
  kinds: {
    closed_curve: "Geschlossene Kontur", open_curve: "Offene Kurve", surface: "Fläche", subdivision: "Unterteilungsfläche", landmarks: "Landmarken",
    points: (count) => `${count} Kontrollpunkte`, intervals: (count) => `${count} Abschnitte`,
  },
  topologies: { sphere: "Kugel", cylinder: "Zylinder", torus: "Torus", plane: "Blatt" },
  correspondences: { cyclic: "der Anfangspunkt wird gesucht (zyklisch)", arc_length: "nach Bogenlänge ab dem ersten Punkt", landmarks: "Punkt für Punkt, wie gegeben" },
  attributes: {
    external_id: "Externe Kennung", label: "Bezeichnung", subject: "Proband", created_at: "Angelegt", "measures.points": "Punkte", "measures.centroid_size": "Zentroidgröße", "measures.length": "Länge",
    "measures.area": "Flächeninhalt", "measures.volume": "Volumen", "measures.self_intersecting": "Schneidet sich selbst",
  },
  cohorts: {
    lead: "Eine Kohorte ist eine benannte Menge gleichartiger Formen, deren Punkte nach einer Regel einander zugeordnet werden.", create: "Neue Kohorte", none: "Es gibt noch keine Kohorten.", plane: "in der Ebene", space: "im Raum",
    correspondence: "Zuordnung der Punkte", sizes: { closed_curve: "Kontrollpunkte", open_curve: "Abschnitte", landmarks: "Landmarken", surface: "Kontrollpunkte längs u" },
  },
  cohort: {
    overview: "Formen", table: "Tabelle", mean: "Mittel", compare: "Gruppen", regression: "Regression", upload: "Hochladen",
    shape: "1 Form", shapes: (count) => `${count} Formen`, revision: (revision) => `Revision ${revision}`, unit: (unit) => `Längen in ${unit}`,
    filters: "Filter", all: (count) => `Alle ${count} Formen`, some: (some, all) => `${some} von ${all} Formen`, without: (name, value) => `Filter ${name} ${value} entfernen`,
    from: (name) => `${name}: mindestens`, to: (name) => `${name}: höchstens`, spark: (name) => `Histogramm: ${name}`, sheet: "Übersicht", scale: "Maßstab", oneScale: "Ein Maßstab", ownScale: "Jede eingepasst", nothing: "Keine Form erfüllt den Filter.",
    sizes: (median, low, high, unit) => `Median ${median}${unit && ` ${unit}`}; neun von zehn liegen zwischen ${low} und ${high}.`, same: (value) => `Alle Formen haben den Wert ${value}.`,
    empty: "Diese Kohorte enthält noch keine Formen.", deleted: (name) => `${name} liegt im Papierkorb.`, deleteTitle: (name) => `${name} löschen?`, deleteHint: "Die Kohorte kommt mit allen Formen in den Papierkorb. Von dort kann die Verwaltung sie zurückholen. Daraus gelernte Wörterbücher bleiben.", changeTitle: (name) => `${name} bearbeiten`,
  },
  shape: {
    alt: (name) => `Die Form ${name}`, caption: "Die Form in ihrer eigenen Lage und Größe.", about: "Maße", correct: "Berichtigen", deleted: (name) => `${name} wurde gelöscht.`,
    neighbours: "Ähnlichste Formen", neighboursAlt: "Die Form und die ihr ähnlichsten Formen, an ihr ausgerichtet", distanceHint: "Abstände nach der Ausrichtung, als Bruchteile der Größe der Form: 0 ist dieselbe Form.",
  },
  solid: { turn: "Ziehen oder Pfeiltasten drehen; Scrollen führt näher heran." },
  mean: {
    class: "Unterschiede, die nicht zählen", alignment: "Ausrichtung", standard: "üblich für die Klasse", projection: "Projektion (geschlossene Form)", partial: "partielle Procrustes-Ausrichtung", frame: "Lage des Mittels", training: "wie die Formen liegen", canonical: "kanonisch: für alle gleich",
    alt: (cohort) => `Mittel von ${cohort} vor den ausgerichteten Formen`, caption: (count) => `Das Mittel vor ${count} ausgerichteten Formen. Es ist immer aktuell: Formen, die eintreffen, verändern es hier.`,
    eigenvalues: "Eigenwerte des Mittelwertoperators", eigenvalue: "Eigenwert", eigenvaluesHint: "Der Raum des Mittels gehört zu den größten Eigenwerten. Je größer die Lücke zum nächsten, desto besser ist das Mittel bestimmt.",
    certificate: "Ist das Mittel eindeutig?", unique: "Ja: Es gibt genau ein Mittel, in welcher Reihenfolge die Formen auch stehen.", notUnique: "Nein: Mehrere Mittel passen gleich gut. Unter dieser Klasse unterscheiden sich die Formen zu stark.", noCertificate: "Diese Ausrichtung ist iterativ: Sie konvergiert, liefert aber keinen Nachweis.", gap: "Lücke der Eigenwerte", rounds: "Runden", converged: "Konvergiert",
  },
  classes: {
    own: ["Eigene Matrizen", "Eine durch Matrizen gegebene Klasse."],
    translation: ["Verschiebung", "Die Lage zählt nicht. Größe, Ausrichtung und Gestalt zählen."], uniform_scaling: ["Skalierung", "Die Größe um den Ursprung zählt nicht. Lage und Ausrichtung zählen."],
    uniform_scaling_translation: ["Skalierung und Verschiebung", "Größe und Lage zählen nicht. Die Ausrichtung zählt."], non_uniform_scaling: ["Skalierung je Achse", "Breite und Höhe um den Ursprung zählen nicht, jede für sich."],
    non_uniform_scaling_translation: ["Skalierung je Achse, Verschiebung", "Breite, Höhe und Lage zählen nicht. Die Ausrichtung zählt."], scaled_rotation: ["Skalierung und Drehung", "Größe und Drehung um den Ursprung zählen nicht. Die Lage zählt."],
    similarity: ["Ähnlichkeit", "Lage, Größe und Drehung zählen nicht: Übrig bleibt die Gestalt. Die übliche Wahl."], linear: ["Lineare Abbildungen", "Größe, Drehung und Scherung um den Ursprung zählen nicht. Die Lage zählt."],
    affine: ["Affine Abbildungen", "Lage, Größe, Drehung und Scherung zählen nicht: Eine Ellipse gilt als Kreis."], horizontal_shear: ["Waagrechte Scherung", "Größe und waagrechte Scherung um den Ursprung zählen nicht."],
    horizontal_shear_translation: ["Waagrechte Scherung, Verschiebung", "Lage, Größe und waagrechte Scherung zählen nicht."], vertical_shear: ["Senkrechte Scherung", "Größe und senkrechte Scherung um den Ursprung zählen nicht."],
    vertical_shear_translation: ["Senkrechte Scherung, Verschiebung", "Lage, Größe und senkrechte Scherung zählen nicht."], reflected_scaled_rotation: ["Gespiegelt, skaliert und gedreht", "Wie Skalierung und Drehung, nach einer Spiegelung."],
    reflected_similarity: ["Gespiegelte Ähnlichkeit", "Wie Ähnlichkeit, nach einer Spiegelung: Links wird mit Rechts verglichen."], rigid: ["Starre Bewegungen", "Lage und Drehung zählen nicht. Die Größe zählt."],
  },
  compare: {
    settings: "Einstellungen", by: "Gruppen nach", permutations: "Permutationen", hint: "Die Filter der Kohorte gelten auch hier. Der Test vertauscht die Gruppen; er setzt keine Verteilung voraus.",
    noGroups: "Kein Merkmal teilt diese Formen in Gruppen. Ergänzen Sie zuerst eine Bezeichnung oder ein Merkmal.", alt: (first, second) => `Mittel der Gruppen, und wo sich ${first} und ${second} unterscheiden`,
    caption: (first, second) => `Die Mittel der Gruppen übereinander und der Unterschied auf ${first}: Das Paar mit dem größten Abstand ist ${first} und ${second}.`,
    effect: (first, second) => `Wo sich ${first} und ${second} unterscheiden`, along: "Ort entlang der Kontur", effectAlt: (some, all) => `p entlang der Kontur: an ${some} von ${all} Orten höchstens 0,05`,
    effectHint: (some, all) => `An ${some} von ${all} Orten ist p höchstens 0,05, korrigiert für die Zahl der Orte.`,
    sideBySide: "Mittel nebeneinander", linked: "Beide drehen sich gemeinsam: Ziehen Sie an einem, oder nutzen Sie die Pfeiltasten.", pairs: "Paare von Gruppen", pair: "Paar", holm: "p (Holm)", overall: "Alle Gruppen", pairsHint: (count) => `R² ist der Teil der Variation, den die Gruppen erklären. p aus ${count} Permutationen; die Korrektur nach Holm gilt für die Zahl der Paare.`,
    sizes: "Größen vor der Ausrichtung", group: "Gruppe", spread: "Streuung", sizesHint: "Mittelwert ± Standardabweichung. Streuung ist der typische Abstand einer Form vom Mittel ihrer Gruppe nach der Ausrichtung.",
    untested: (name) => `${name} wurde nicht getestet.`, differ: (name, p, r) => `Die Formen unterscheiden sich nach ${name} (p ${p.startsWith("<") ? p : `= ${p}`}); das erklärt ${r} ihrer Variation.`,
    same: (name, p) => `Nach ${name} wurde kein Unterschied gefunden (p = ${p}). Das zeigt nicht, dass es keinen gibt.`, clear: (pairs) => `Deutliche Paare: ${pairs}.`, noneClear: "Nach der Korrektur ist kein einzelnes Paar deutlich.",
  },
  regression: {
    attribute: "Hängt ab von", size: "Logarithmus der Zentroidgröße", sizeName: "der Größe", covariate: "Bereinigt um", partial: "partielles R²", slider: (name) => `Vorhergesagte Form für ${name}`, slideHint: "Die vorhergesagte Form vor dem Durchschnitt.",
    scores: "Jede Form", score: "Formwert", scoresHint: "Der Wert einer Form sagt, wie weit sie in Richtung der Regression liegt.", alt: (name) => `Vorhergesagte Formen für Werte von ${name}`, caption: "Vorhersagen vom 5-%- bis zum 95-%-Quantil.",
    depends: (name, p, r) => `Die Form hängt ab von ${name} (p ${p.startsWith("<") ? p : `= ${p}`}); das erklärt ${r} der Variation.`, independent: (name, p) => `Eine Abhängigkeit der Form von ${name} wurde nicht gefunden (p = ${p}).`,
  },
  upload: {
    lead: "Jede Form wird geprüft, bevor sie gespeichert wird. Dieselbe Datei kann noch einmal gesendet werden: Formen mit bekannter Kennung und gleichem Inhalt werden nicht doppelt gespeichert.", onError: "Fehlerhafte Formen", skip: "Fehlerhafte auslassen", abort: "Alles oder nichts",
    drop: "Dateien hier ablegen", formats: "JSON, NDJSON, GeoJSON, CSV, TPS, Labelmasken (PNG, TIFF, NIfTI)", choose: "Dateien wählen", added: (count) => `${count} hinzugefügt`, skipped: (count) => `${count} ausgelassen`, failed: "Nichts gespeichert",
    stopped: "Abgebrochen. Aus dieser Datei wurde nichts gespeichert.", syntax: (message) => `Die Datei ist kein gültiges JSON: ${message}`, crossing: (count) => `${count} der Formen schneiden sich selbst. Sie sind gespeichert; sehen Sie sie an, bevor Sie Schlüsse ziehen.`,
    left: (count) => (count === 1 ? "1 Form wurde ausgelassen:" : `${count} Formen wurden ausgelassen:`), repeated: (count) => `${count} wiederholte Punkte wurden ausgelassen.`, look: "Kohorte ansehen",
  },
  dictionaries: {
    lead: "Ein Wörterbuch ist ein aus einer Kohorte gelerntes Modell: das Mittel und was um es variiert. Es ändert sich nie; erneutes Lernen ergibt eine neue Version.", none: "Es wurde noch kein Wörterbuch gelernt.",
    atoms: (count) => `${count} dünn besetzte Atome`, components: (count) => `${count} Komponenten`,
  },
  learn: {
    title: "Wörterbuch lernen", components: "Komponenten", sparse: "Dünn besetzte Atome", atoms: "Zahl der Atome", number: "Zahl der Komponenten", nonzeros: "Atome je Form", classes: "Unterscheiden", begin: "Lernen", busy: "Wird gelernt …", background: "Im Hintergrund weiter",
    done: (name) => `${name} ist gelernt.`, only: "Nur Formen mit:", sparseHint: "Atome sind typische Formen; jede Form ist eine Summe von wenigen.", componentsHint: "Komponenten sind die Richtungen, in denen die Formen am stärksten variieren, die stärkste zuerst.",
  },
  dictionary: {
    report: "Bericht", modes: "Moden", scores: "Werte", components: "Komponenten", atoms: "Atome", drift: "Drift", lead: (cohort, shapes, name, time) => `Gelernt aus ${shapes} Formen von ${cohort}, unter der Klasse „${name}“, ${time}.`,
    deleteHint: "Diese Version kommt in den Papierkorb. Von dort kann die Verwaltung sie zurückholen.", atomsHint: "Jede Form wird durch wenige dieser Atome beschrieben, bewegt und skaliert, wie sie es braucht.", componentsHint: "Jede Komponente bei zwei Standardabweichungen auf beiden Seiten des Mittels, rot und blau. Das Mittel ist grau.",
    atomsAlt: (count) => `${count} Atome nebeneinander`, atom: (number) => `Atom ${number}`, component: (number) => `Komponente ${number}`, use: (part) => `von ${part} der Formen verwendet`, share: (part) => `${part} der Variation`,
  },
  report: {
    kept: (count) => `Von ${count} Komponenten erfasst`, error: "Rekonstruktionsfehler", accuracy: "Treffer", mean: "Mittel", unique: "eindeutig", notUnique: "nicht eindeutig", explained: "Erklärte Variation", part: "Anteil", each: "einzeln", sum: "zusammen",
    explainedAlt: (values) => `Anteil der Variation, den jede Komponente erklärt: ${values}`, explainedHint: "Balken: jede Komponente. Linie: alle Komponenten bis dorthin.", history: "Verlauf des Lernens", objective: "Zielgröße", pass: "Durchgang", historyHint: "Die mittleren Kosten, eine Form zu beschreiben, nach jedem Durchgang.",
    origin: "Herkunft", filter: "Filter", program: "Programm", digest: "Prüfsumme", originHint: "Dieselben Formen und Einstellungen ergeben dieselbe Prüfsumme: Alle können das wiederholen.", classes: "Klassen", class: "Klasse", noClasses: "Dieses Wörterbuch wurde ohne Klassen gelernt. Lernen Sie eines, das eine Bezeichnung unterscheidet.",
    accuracyText: (value, low, high, majority) => `${value} der Formen, aus denen nicht gelernt wurde, werden richtig eingeordnet (95-%-Intervall ${low} bis ${high}). Immer die häufigste Klasse zu nennen, träfe zu ${majority}.`,
    confusion: "Zeilen: wahre Klasse. Spalten: vorhergesagte Klasse.", recall: "Gefunden", folds: (folds, repeats) => `Aus ${repeats} Wiederholungen der Kreuzvalidierung in ${folds} Teilen.`,
  },
  modes: {
    sliders: "Moden der Variation", mode: (number) => `Mode ${number}`, reset: "Zurücksetzen", play: "Abspielen", stop: "Anhalten", hint: "σ ist die Standardabweichung einer Mode unter den Formen. Kombinationen jenseits von ±2 σ sind selten.",
    alt: "Form der gewählten Moden", caption: "Die Form der Regler, vor dem Mittel.", one: (number) => `Mode ${number} allein`, stripCaption: "Von minus zwei bis plus zwei Standardabweichungen.", strip: "Formen dieser Art sind unten als Streifen gezeichnet.",
  },
  scores: {
    across: "Waagrecht", up: "Senkrecht", colour: "Farbe", tool: "Zeiger", lasso: "Lasso", zoom: "Zoom", morphospace: "Formen in der Ebene", outlier: "Ungewöhnliche Formen", class: "Vorhergesagte Klasse", noCohort: "Die Kohorte dieses Wörterbuchs gibt es in diesem Dienst nicht.",
    alt: (count) => `Streudiagramm der Werte von ${count} Formen`, caption: (count) => `${count} Formen. Zeigen Sie auf eine, um sie zu sehen; umfahren Sie einige, um sie zu wählen; Scrollen vergrößert, ein Doppelklick zeigt alle.`,
    selection: "Auswahl", selectionHint: "Ziehen Sie eine Linie um Punkte, um Formen zu wählen und ihr Mittel zu sehen.", chosen: (count) => `${count} gewählt`, clear: "Aufheben", meanOf: "Mittel der gewählten Formen vor dem Mittel aller.", others: (count) => `und ${count} weitere`, open: "Als Filter öffnen", rest: (count) => `${count} weitere`,
  },
  drift: {
    none: (revision) => `Seit das Wörterbuch bei Revision ${revision} gelernt wurde, sind keine Formen hinzugekommen. Neue Formen erscheinen hier, sobald sie eintreffen.`, alt: "Werte der neuen Formen gegen die des Trainings", scores: "Werte", shift: "Verschiebung", spread: "Streuung",
    sentence: (shapes, outliers, rate, expected) => `Von ${shapes} neuen Formen sind ${outliers} ungewöhnlich (${rate}); etwa ${expected} wären zu erwarten, wenn sich nichts geändert hätte.`,
    quantile: "Grenze des Üblichen", fresh: "Neue Formen", outliers: "Ungewöhnlich", angle: "Winkel zwischen den Mitteln", expected: "Zufällig erwartet", classes: "Klassen", training: "Training",
  },
  assess: {
    title: "Form beurteilen", lead: "Vergleichen Sie eine Form mit dem, was ein Wörterbuch gelernt hat: Lage, Klasse, Neuheit und wo sie abweicht.", print: "Drucken oder als PDF sichern", nothing: "Die Datei enthält keine Form.", posted: "Übergebene Form", withClasses: "mit Klassen",
    stored: (cohort) => `Oder eine Form aus ${cohort}, nach Kennung`, drop: "Kontur oder Maske ablegen", formats: "JSON, GeoJSON, CSV, TPS, Labelmaske (PNG, TIFF, NIfTI)", noClass: "keine Klasse",
    verdict: (label, confidence, accepted) => (accepted === false ? `Aus keiner der bekannten Klassen; die nächste ist ${label}.` : `Am ehesten ${label} (${confidence}).`), usual: "Eine übliche Form", unusual: "Eine ungewöhnliche Form",
    outlier: "ungewöhnlich: jenseits der Grenze von 99 % der Formen", inlier: "im Rahmen des Üblichen", against: (name, shapes, time) => `verglichen mit ${name}, gelernt aus ${shapes} Formen, ${time}`,
    where: "Wo sie abweicht", whereAlt: (name) => `${name}, gefärbt nach dem Abstand von der Rekonstruktion`, whereCaption: "Die Form, gefärbt nach ihrem Abstand von der Rekonstruktion durch das Wörterbuch.",
    accuracy: (value, majority) => `Bei ungesehenen Formen waren ${value} solcher Antworten richtig; die häufigste Klasse allein ergäbe ${majority}.`, novelty: "Wie ungewöhnlich", within: "Entlang der Moden", beyond: "Jenseits der Moden", rank: (part) => `ungewöhnlicher als ${part} der Formen`, first: "ungewöhnlicher als jede Form, aus der gelernt wurde", rejected: "Die Form wurde zurückgewiesen: Diese Werte vergleichen nur die Klassen untereinander.",
    error: "Relativer Fehler", noveltyHint: "Entlang der Moden: extrem, aber von bekannter Art. Jenseits der Moden: von einer Art, die das Wörterbuch nicht kennt.", code: "Code", scores: "Werte in Standardabweichungen der gelernten Formen.", atoms: "Gewichte der verwendeten Atome.", weight: "Gewicht", picture: "Ein Foto, keine Maske? Finden Sie zuerst die Kontur:", pose: "Lage", scale: "Größe, je Einheit des Mittels", angle: "Drehung", nearest: "Ähnlichste Formen", printed: (time) => `Shapelex, ${time}. Eine statistische Beschreibung, keine Diagnose.`,
  },
  jobs: {
    lead: "Lange Arbeiten, während sie laufen. Sie gehen weiter, wenn Sie die Seite verlassen, auch nach einem Neustart des Dienstes.", live: "verbunden", offline: "nicht verbunden", status: "Status", all: "alle", none: "Keine Aufträge.", work: "Arbeit", progress: "Fortschritt", begun: "Begonnen", duration: "Dauer", running: "Wird berechnet …",
    left: (seconds) => `noch etwa ${seconds} s`, cancelled: "Der Auftrag wird abgebrochen.", states: { queued: "wartet", running: "läuft", succeeded: "fertig", failed: "fehlgeschlagen", cancelled: "abgebrochen" },
    kinds: { learn_dictionary: "Lernen eines Wörterbuchs", distances: "Abstände", compare: "Vergleich von Gruppen", regress: "Regression", assess: "Beurteilung einer Kohorte" },
  },
  console: {
    lead: "Jede Anfrage dieser Seite kann auch ein Programm stellen. Füllen Sie eine aus, senden Sie sie, kopieren Sie sie.", operation: "Anfrage", optional: (count) => `${count} weitere Einstellungen`, body: "Inhalt", send: "Senden", copy: "Als Programm", answer: "Antwort",
    files: "Diese Anfrage braucht eine Datei; die Kopie ist ein Anfang.",
  },
  segment: {
    lead: "Ziehen Sie einen Rahmen um ein Objekt. Eine Kontur beginnt darin und wandert zum Rand; berichtigen Sie einen Punkt, wo sie irrt, und lassen Sie sie weiterlaufen.", drop: "Bild ablegen", formats: "PNG, JPEG oder WebP; es bleibt zwischen dieser Seite und dem Dienst", unreadable: (name) => `${name} ist kein Bild, das dieser Browser lesen kann.`,
    alt: (name) => `${name} mit Rahmen und Kontur`, box: "Ziehen Sie einen Rahmen um ein Objekt.", correct: "Ziehen Sie einen Punkt an seinen Ort und setzen Sie fort; Ziehen an anderer Stelle ergibt einen neuen Rahmen.", size: (width, height) => `${width} × ${height} Pixel.`, run: "Kontur finden", resume: "Von hier weiter", assess: "Diese Form beurteilen", other: "Anderes Bild",
    history: "Energie nach jedem Schritt", energy: "Energie", iteration: "Schritt", iterations: "Schritte", term: "Das Objekt zeigt sich durch", polarity: "Das Objekt ist", bright: "hell", dark: "dunkel", sigma: "Unschärfe in Pixeln", points: "Kontrollpunkte", boxOf: "Rahmen, in Pixeln", sides: { x: "Links", y: "Oben", w: "Breite", h: "Höhe" }, result: "Ergebnis",
    terms: {
      contour: ["seinen Rand", "Der Gradient kreuzt den Rand: Objekte mit Kanten ringsum."], local_contrast: ["Kontrast zur Umgebung", "Das Mittel innen unterscheidet sich von dem einer Hülle darum: ungleichmäßige Hintergründe."],
      two_class: ["zwei Grauwerte", "Ein Grau innen, eines außen: Objekte etwa so groß wie der Rest."], threshold: ["seine Helligkeit", "Heller als ein Pegel: Objekte bekannter Helligkeit."],
    },
    stops: { converged: "Die Kontur ist zur Ruhe gekommen.", limit: "Die Kontur bewegte sich beim letzten Schritt noch. Setzen Sie von hier fort.", line_search: "Die Kontur ist auf der Höhe des Rauschens zur Ruhe gekommen.", folded: "Die Kontur hat sich gefaltet. Versuchen Sie einen besseren Rahmen oder weniger Kontrollpunkte.", left_image: "Die Kontur hat das Bild verlassen. Versuchen Sie einen besseren Rahmen.", collapsed: "Von der Kontur blieb nichts übrig. Versuchen Sie die andere Polarität." },
  },
  administration: {
    lead: "Wer was darf, wer was getan hat und was sich noch zurückholen lässt. Diese Ansichten verlangen die Rolle der Verwaltung.", actions: "Aktionen", parts: { keys: "Schlüssel", hooks: "Hooks", audit: "Protokoll", trash: "Papierkorb" },
    secret: "Wird nur dieses eine Mal gezeigt. Kopieren Sie ihn jetzt.", firstKey: "Es gibt keine Schlüssel: Alle auf dieser Maschine haben die Rolle der Verwaltung. Der erste Schlüssel schließt den Dienst; geben Sie ihm diese Rolle.", newKey: "Neuer Schlüssel", role: "Rolle", roles: { reader: "Lesen", writer: "Schreiben", admin: "Verwaltung" },
    days: "Läuft ab in Tagen", never: "nie", noKeys: "Keine Schlüssel.", expires: "Läuft ab", used: "Zuletzt benutzt", revoke: "Widerrufen", revoked: "Der Schlüssel wurde widerrufen.", isRevoked: "widerrufen", newHook: "Neuer Hook", address: "Adresse", noHooks: "Keine Hooks.", position: "Zugestellt bis", pause: "Anhalten", resume: "Fortsetzen",
    states: { active: "aktiv", paused: "angehalten", failed: "fehlgeschlagen" }, auditHint: "Die letzten 24 Stunden, das Neueste zuerst, höchstens 200 Anfragen. Der Download enthält alle.", noAudit: "Keine Einträge.", at: "Zeit", request: "Anfrage", key: "Schlüssel", noTrash: "Der Papierkorb ist leer.", deleted: "Gelöscht",
    kinds: { cohort: "Kohorte", dictionary: "Wörterbuch" }, restore: "Zurückholen", forever: "Endgültig löschen", restored: "Zurückgeholt.", gone: "Endgültig gelöscht.",
  },
};
