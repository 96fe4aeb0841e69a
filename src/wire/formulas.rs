//! Texts in CSV that a spreadsheet would run as formulas.
//!
//! A field that begins with `=`, `+`, `-`, `@`, a tab or a carriage return and is not a number is a formula to spreadsheets,
//! whoever wrote it. An apostrophe before it makes it a text.

use std::io::{self, Write};

/// Makes texts of formulas of spreadsheets, in CSV that comes in pieces.
#[derive(Debug, Default)]
pub struct Escaping {
    /// The field that has begun.
    field: Vec<u8>,
    is_quoted: bool,
}

impl Escaping {
    /// The next bytes; a field that has not ended stays behind.
    pub fn piece(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut written = Vec::with_capacity(bytes.len() + 16);
        for &byte in bytes {
            // A doubled quote inside of quotes ends them and begins them anew.
            self.is_quoted ^= byte == b'"';
            if !self.is_quoted && matches!(byte, b',' | b'\r' | b'\n') {
                self.end(&mut written);
                written.push(byte);
            } else {
                self.field.push(byte);
            }
        }
        written
    }

    /// The remaining bytes at the end.
    pub fn rest(&mut self) -> Vec<u8> {
        let mut written = Vec::new();
        self.end(&mut written);
        written
    }

    fn end(&mut self, written: &mut Vec<u8>) {
        let (quote, text) = match self.field.as_slice() {
            [b'"', text @ ..] => (b"\"".as_slice(), text),
            text => (b"".as_slice(), text),
        };
        if is_formula(text.strip_suffix(quote).unwrap_or(text)) {
            written.extend_from_slice(quote);
            written.push(b'\'');
            written.extend_from_slice(text);
        } else {
            written.extend_from_slice(&self.field);
        }
        self.field.clear();
    }
}

/// Output that counts its bytes, and may escape formulas on their way.
pub struct Escaped<'o> {
    output: &'o mut (dyn Write + Send),
    escaping: Option<Escaping>,
    bytes: u64,
}

impl<'o> Escaped<'o> {
    /// An output, which escapes formulas where `escapes` is set.
    pub fn new(output: &'o mut (dyn Write + Send), escapes: bool) -> Self {
        Self { output, escaping: escapes.then(Escaping::default), bytes: 0 }
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.output.write_all(bytes)?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Writes the remaining bytes, and returns the number of bytes written.
    ///
    /// # Errors
    /// Those of the output.
    pub fn end(mut self) -> io::Result<u64> {
        let rest = self.escaping.take().map(|mut escaping| escaping.rest()).unwrap_or_default();
        self.put(&rest)?;
        Ok(self.bytes)
    }
}

impl Write for Escaped<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.escaping {
            Some(escaping) => {
                let piece = escaping.piece(bytes);
                self.put(&piece)?;
            }
            None => self.put(bytes)?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.output.flush()
    }
}

/// Whether a spreadsheet runs a text.
fn is_formula(text: &[u8]) -> bool {
    let number = || std::str::from_utf8(text).ok()?.parse::<f64>().ok();
    matches!(text, [b'=' | b'+' | b'-' | b'@' | b'\t' | b'\r', ..]) && number().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_become_texts_wherever_pieces_end() {
        let csv = "id,=label\r\n=1+1,-0.5\r\n\"=HYPERLINK(\"\"a\"\",b)\",+1e3\r\n@SUM(A1),-x\r\n\"a,=b\",a=b\r\n'=c,\"-7\"\r\n-";
        let wanted = "id,'=label\r\n'=1+1,-0.5\r\n\"'=HYPERLINK(\"\"a\"\",b)\",+1e3\r\n'@SUM(A1),'-x\r\n\"a,=b\",a=b\r\n'=c,\"-7\"\r\n'-";
        for size in [1, 2, 3, 7, csv.len()] {
            let mut escaping = Escaping::default();
            let mut found: Vec<u8> =
                csv.as_bytes().chunks(size).flat_map(|piece| escaping.piece(piece)).collect();
            found.extend(escaping.rest());
            assert_eq!(String::from_utf8(found).unwrap(), wanted, "pieces of {size} bytes");
        }
    }
}
