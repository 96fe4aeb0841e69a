/** Files and folders by drag and drop, or by the buttons that every keyboard reaches. */
import { useRef, useState } from "preact/hooks";
import { t } from "../strings";

/** Files of a folder that are of the system, or of an archive program. */
const HIDDEN = /(^|\/)(\.|__MACOSX\/|Thumbs\.db$|desktop\.ini$)/;

const filesOf = (entry: FileSystemEntry): Promise<File[]> =>
  entry.isFile
    ? new Promise((resolve) =>
        (entry as FileSystemFileEntry).file(
          (file) => resolve([file]),
          () => resolve([]),
        ),
      )
    : entriesOf((entry as FileSystemDirectoryEntry).createReader()).then(async (entries) =>
        (await Promise.all(entries.map(filesOf))).flat(),
      );

/** All entries of a folder: browsers answer them in parts. */
async function entriesOf(reader: FileSystemDirectoryReader): Promise<FileSystemEntry[]> {
  const part = await new Promise<FileSystemEntry[]>((resolve) => reader.readEntries(resolve, () => resolve([])));
  return part.length ? [...part, ...(await entriesOf(reader))] : [];
}

const sorted = (files: File[]): File[] =>
  files
    .filter((file) => !HIDDEN.test(file.webkitRelativePath || file.name))
    .sort((a, b) => a.name.localeCompare(b.name, undefined, { numeric: true }));

export function Drop({
  title,
  hint,
  accept,
  multiple,
  onFiles,
}: {
  title: string;
  hint: string;
  accept?: string;
  multiple?: boolean;
  onFiles: (files: File[]) => void;
}) {
  const [over, setOver] = useState(false);
  const input = useRef<HTMLInputElement>(null);
  const take = (list: FileList | null | undefined) => {
    if (list?.length) onFiles([...list]);
  };
  const takeFolder = (files: File[]) => {
    const kept = sorted(files);
    if (kept.length) onFiles(kept);
  };
  const folder = () => {
    const chooser = Object.assign(document.createElement("input"), { type: "file", webkitdirectory: true });
    chooser.onchange = () => takeFolder([...(chooser.files ?? [])]);
    chooser.click();
  };
  const dropped = (transfer: DataTransfer | null) => {
    const entries = [...(transfer?.items ?? [])].flatMap((item) => item.webkitGetAsEntry?.() ?? []);
    if (multiple && entries.some((entry) => entry.isDirectory))
      void Promise.all(entries.map(filesOf)).then((found) => takeFolder(found.flat()));
    else take(transfer?.files);
  };
  return (
    <div
      class={`drop no-print${over ? " over" : ""}`}
      onDragOver={(event) => {
        event.preventDefault();
        setOver(true);
      }}
      onDragLeave={() => setOver(false)}
      onDrop={(event) => {
        event.preventDefault();
        setOver(false);
        dropped(event.dataTransfer);
      }}
    >
      <strong>{title}</strong>
      <span class="small">{hint}</span>
      <div class="row">
        <button type="button" onClick={() => input.current?.click()}>
          {t.upload.choose}
        </button>
        {multiple && (
          <button type="button" onClick={folder}>
            {t.upload.folder}
          </button>
        )}
      </div>
      <input
        ref={input}
        type="file"
        hidden
        accept={accept}
        multiple={multiple}
        aria-label={title}
        onChange={(event) => {
          take(event.currentTarget.files);
          event.currentTarget.value = "";
        }}
      />
    </div>
  );
}
