/** Fields of forms. */
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";

export function Field({ label, children }: { label: string; children: ComponentChildren }) {
  return (
    <label class="field">
      <span>{label}</span>
      {children}
    </label>
  );
}

/** One of a few, side by side; radio buttons for the keyboard. */
export function Choice({
  label,
  value,
  options,
  onChange,
}: {
  label: string;
  value: string;
  options: [string, string][];
  onChange: (value: string) => void;
}) {
  const [name] = useState(() => `choice-${Math.random().toString(36).slice(2)}`);
  return (
    <div class="choice" role="radiogroup" aria-label={label}>
      {options.map(([id, text]) => (
        <label key={id}>
          <input type="radio" name={name} checked={value === id} onChange={() => onChange(id)} />
          <span>{text}</span>
        </label>
      ))}
    </div>
  );
}
