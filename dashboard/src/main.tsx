import "./style.css";
import "./preferences";
import { render } from "preact";
import { App } from "./app";

// A file that is dropped beside a zone would open in place of the page.
for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault());

render(<App />, document.getElementById("app")!);
