/** Files by drag and drop, or by the button that every keyboard reaches. */
import { useRef, useState } from "preact/hooks";
import { t } from "../strings";

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
        take(event.dataTransfer?.files);
      }}
    >
      <strong>{title}</strong>
      <span class="small">{hint}</span>
      <button onClick={() => input.current?.click()}>{t.upload.choose}</button>
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
