//! Reading and writing payload fields: little-endian, no padding.

use thiserror::Error;

/// Why a payload cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum PayloadError {
    /// It ends inside a field.
    #[error("the payload ends at byte {0}, inside a field")]
    Short(usize),
    /// Bytes are left over.
    #[error("{0} bytes are left over")]
    Long(usize),
    /// A string is not UTF-8.
    #[error("a text is not UTF-8")]
    Text,
    /// A field holds a value that the page does not allow.
    #[error("{field} is {value}")]
    Value {
        /// Which field.
        field: &'static str,
        /// What it holds.
        value: u64,
    },
}

/// A cursor over a payload.
#[derive(Debug)]
pub struct PayloadReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> PayloadReader<'a> {
    /// Starts at the first byte.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The next `count` bytes.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8], PayloadError> {
        let end = self.at.checked_add(count).filter(|&end| end <= self.bytes.len());
        let end = end.ok_or(PayloadError::Short(self.bytes.len()))?;
        let bytes = &self.bytes[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PayloadError> {
        Ok(self.bytes(N)?.try_into().expect("bytes() gave N of them"))
    }

    /// One byte.
    pub fn u8(&mut self) -> Result<u8, PayloadError> {
        Ok(self.array::<1>()?[0])
    }

    /// Two bytes.
    pub fn u16(&mut self) -> Result<u16, PayloadError> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    /// Four bytes.
    pub fn u32(&mut self) -> Result<u32, PayloadError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// Eight bytes.
    pub fn u64(&mut self) -> Result<u64, PayloadError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// A float.
    pub fn f32(&mut self) -> Result<f32, PayloadError> {
        Ok(f32::from_le_bytes(self.array()?))
    }

    /// Three floats.
    pub fn f32x3(&mut self) -> Result<[f32; 3], PayloadError> {
        Ok([self.f32()?, self.f32()?, self.f32()?])
    }

    /// A text with a one-byte length.
    pub fn str8(&mut self) -> Result<String, PayloadError> {
        let length = self.u8()?;
        self.text(usize::from(length))
    }

    /// A text with a two-byte length.
    pub fn str16(&mut self) -> Result<String, PayloadError> {
        let length = self.u16()?;
        self.text(usize::from(length))
    }

    fn text(&mut self, length: usize) -> Result<String, PayloadError> {
        String::from_utf8(self.bytes(length)?.to_vec()).map_err(|_| PayloadError::Text)
    }

    /// Reserved bytes, which must be 0.
    pub fn reserved(&mut self, count: usize) -> Result<(), PayloadError> {
        match self.bytes(count)?.iter().find(|&&byte| byte != 0) {
            None => Ok(()),
            Some(&byte) => Err(PayloadError::Value {
                field: "a reserved byte",
                value: u64::from(byte),
            }),
        }
    }

    /// Everything that is left.
    pub fn rest(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        self.at = self.bytes.len();
        rest
    }

    /// Fails when bytes are left over.
    pub fn end(self) -> Result<(), PayloadError> {
        match self.bytes.len() - self.at {
            0 => Ok(()),
            left => Err(PayloadError::Long(left)),
        }
    }
}

/// Appends a text with a one-byte length; longer texts are cut at 255 bytes on a character border.
pub fn put_str8(bytes: &mut Vec<u8>, text: &str) {
    let mut end = text.len().min(255);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    bytes.push(end as u8);
    bytes.extend_from_slice(&text.as_bytes()[..end]);
}
