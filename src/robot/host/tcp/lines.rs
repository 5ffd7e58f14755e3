//! Lines out of a stream of bytes, however it is cut into segments.

/// Gathers the bytes of one line at a time.
///
/// Data end in CR alone and everything else in CR LF, so a line ends with its CR and a LF right behind it belongs to it;
/// a LF by itself ends a line too.
#[derive(Debug, Default)]
pub(super) struct Lines {
    bytes: Vec<u8>,
    after_cr: bool,
}

/// A line grew beyond [`LINE_BYTES_MAX`].
#[derive(Debug, PartialEq, Eq)]
pub(super) struct TooLong;

impl Lines {
    /// Takes one byte; gives the line that it ends, without its end.
    pub(super) fn push(&mut self, byte: u8) -> Result<Option<String>, TooLong> {
        let after_cr = std::mem::replace(&mut self.after_cr, byte == b'\r');
        match byte {
            b'\n' if after_cr => Ok(None),
            b'\r' | b'\n' => {
                let line = String::from_utf8_lossy(&self.bytes).into_owned();
                self.bytes.clear();
                Ok(Some(line))
            }
            _ if self.bytes.len() == LINE_BYTES_MAX => Err(TooLong),
            byte => {
                self.bytes.push(byte);
                Ok(None)
            }
        }
    }
}

/// No answer of a command that we say comes near.
pub(super) const LINE_BYTES_MAX: usize = 16_384;
