//! Reading and writing payload fields: little-endian, no padding.

use super::settings::SettingsError;
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
    /// A list of settings is damaged or wrong.
    #[error(transparent)]
    Settings(#[from] SettingsError),
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

    /// One field of a payload.
    pub fn field<F: Field>(&mut self) -> Result<F, PayloadError> {
        F::read(self)
    }

    /// A text with a one-byte length.
    pub fn str8(&mut self) -> Result<String, PayloadError> {
        let length: u8 = self.field()?;
        self.text(usize::from(length))
    }

    /// A text with a two-byte length.
    pub fn str16(&mut self) -> Result<String, PayloadError> {
        let length: u16 = self.field()?;
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

/// What stands in payloads, read and written alike.
pub trait Field: Sized {
    /// Reads it.
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError>;
    /// Appends it.
    fn write(&self, bytes: &mut Vec<u8>);
}

macro_rules! number_fields {
    ($($number:ty),*) => {$(
        impl Field for $number {
            fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
                Ok(Self::from_le_bytes(fields.array()?))
            }

            fn write(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}
number_fields!(u8, u16, u32, u64, i32, f32, f64);

/// 0 or 1.
impl Field for bool {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        match fields.field::<u8>()? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(PayloadError::Value {
                field: "a yes or no",
                value: u64::from(other),
            }),
        }
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.push(u8::from(*self));
    }
}

/// A number that may be unknown: NaN on the wire, as is anything that is not finite here.
impl Field for Option<f32> {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        Ok(Some(fields.field::<f32>()?).filter(|value| value.is_finite()))
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.unwrap_or(f32::NAN).write(bytes);
    }
}

/// A `str8`: at most 255 bytes, cut on a character border when written.
impl Field for String {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        fields.str8()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        let text = cut(self, 255);
        bytes.push(text.len() as u8);
        bytes.extend_from_slice(text.as_bytes());
    }
}

impl<F: Field, const N: usize> Field for [F; N] {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let mut found = Vec::with_capacity(N);
        for _ in 0..N {
            found.push(fields.field()?);
        }
        Ok(found.try_into().unwrap_or_else(|_| unreachable!("the loop pushed N")))
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        for field in self {
            field.write(bytes);
        }
    }
}

/// Appends a `str16`, cut to `max` bytes on a character border.
pub fn put_str16(bytes: &mut Vec<u8>, text: &str, max: u16) {
    let text = cut(text, usize::from(max));
    (text.len() as u16).write(bytes);
    bytes.extend_from_slice(text.as_bytes());
}

/// The longest beginning of the text that fits into so many bytes.
fn cut(text: &str, max: usize) -> &str {
    let mut end = text.len().min(max);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

/// Makes a struct whose fields follow each other in a payload; `pad N` after a field stands for N reserved bytes.
macro_rules! payload_struct {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $field:ident: $type:ty $(, pad $pad:literal)?;)* }) => {
        $(#[$meta])*
        pub struct $name {
            $($(#[$doc])* pub $field: $type,)*
        }

        impl $crate::camera::payload::Field for $name {
            fn read(
                fields: &mut $crate::camera::payload::PayloadReader<'_>,
            ) -> Result<Self, $crate::camera::payload::PayloadError> {
                Ok(Self {
                    $($field: {
                        let value = fields.field()?;
                        $(fields.reserved($pad)?;)?
                        value
                    },)*
                })
            }

            fn write(&self, bytes: &mut Vec<u8>) {
                $(
                    $crate::camera::payload::Field::write(&self.$field, bytes);
                    $(bytes.extend_from_slice(&[0; $pad]);)?
                )*
            }
        }
    };
}
pub(super) use payload_struct;

/// Makes an enum of one-byte codes.
macro_rules! payload_codes {
    ($(#[$meta:meta])* $name:ident, $what:literal { $($(#[$doc:meta])* $code:ident = $value:literal,)* }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $name {
            $($(#[$doc])* $code = $value,)*
        }

        impl $crate::camera::payload::Field for $name {
            fn read(
                fields: &mut $crate::camera::payload::PayloadReader<'_>,
            ) -> Result<Self, $crate::camera::payload::PayloadError> {
                match fields.field::<u8>()? {
                    $($value => Ok(Self::$code),)*
                    other => Err($crate::camera::payload::PayloadError::Value {
                        field: $what,
                        value: u64::from(other),
                    }),
                }
            }

            fn write(&self, bytes: &mut Vec<u8>) {
                bytes.push(*self as u8);
            }
        }
    };
}
pub(super) use payload_codes;
