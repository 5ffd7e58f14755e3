//! Fields of A3DP payloads: little-endian, one after the other, without padding.

use thiserror::Error;

/// Why bytes are not the fields they should be.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FieldError {
    /// Too short, too long, or text that is no UTF-8.
    #[error("the payload does not hold its fields")]
    Malformed,
    /// Reserved bytes are not 0.
    #[error("reserved bytes are not 0")]
    Reserved,
}

impl FieldError {
    /// Code of section 6 of the page.
    pub fn code(self) -> u16 {
        match self {
            Self::Malformed => 108,
            Self::Reserved => 109,
        }
    }
}

/// Something that stands in a payload.
pub trait Field: Sized {
    /// Reads it from the front of `bytes` and takes it away there.
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError>;
    /// Appends it.
    fn write(&self, bytes: &mut Vec<u8>);

    /// The field when it is all there is.
    fn read_whole(mut bytes: &[u8]) -> Result<Self, FieldError> {
        let field = Self::read(&mut bytes)?;
        if bytes.is_empty() {
            Ok(field)
        } else {
            Err(FieldError::Malformed)
        }
    }

    /// The field alone.
    fn to_payload(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.write(&mut bytes);
        bytes
    }
}

/// Reserved bytes; always 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Zero<const N: usize>;

/// UTF-8 text behind a u8 of its byte count; longer text is cut.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Str8(pub String);

/// UTF-8 text behind a u16 of its byte count; longer text is cut.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Str16(pub String);

/// All the bytes that are left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rest(pub Vec<u8>);

macro_rules! number_fields {
    ($($number:ty),*) => {
        $(impl Field for $number {
            fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
                let (field, rest) = bytes.split_first_chunk().ok_or(FieldError::Malformed)?;
                *bytes = rest;
                Ok(<$number>::from_le_bytes(*field))
            }

            fn write(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }
        })*
    };
}

number_fields!(u8, u16, u32, u64, i32, f32, f64);

impl<T: Field + Copy + Default, const N: usize> Field for [T; N] {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        let mut fields = [T::default(); N];
        for field in &mut fields {
            *field = T::read(bytes)?;
        }
        Ok(fields)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|field| field.write(bytes));
    }
}

impl<const N: usize> Field for Zero<N> {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        if <[u8; N]>::read(bytes)? == [0; N] {
            Ok(Self)
        } else {
            Err(FieldError::Reserved)
        }
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&[0; N]);
    }
}

impl Field for Str8 {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        let count = u8::read(bytes)?;
        text(bytes, usize::from(count)).map(Self)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        let text = &self.0[..self.0.floor_char_boundary(usize::from(u8::MAX))];
        (text.len() as u8).write(bytes);
        bytes.extend_from_slice(text.as_bytes());
    }
}

impl Field for Str16 {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        let count = u16::read(bytes)?;
        text(bytes, usize::from(count)).map(Self)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        let text = &self.0[..self.0.floor_char_boundary(TEXT_BYTES_MAX)];
        (text.len() as u16).write(bytes);
        bytes.extend_from_slice(text.as_bytes());
    }
}

impl Field for Rest {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        Ok(Self(core::mem::take(bytes).to_vec()))
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.0);
    }
}

fn text(bytes: &mut &[u8], byte_count: usize) -> Result<String, FieldError> {
    let (text, rest) = bytes.split_at_checked(byte_count).ok_or(FieldError::Malformed)?;
    *bytes = rest;
    String::from_utf8(text.to_vec()).map_err(|_| FieldError::Malformed)
}

/// Declares a structure whose fields stand in a payload in the order of their declaration.
macro_rules! wire_struct {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$field_meta:meta])* pub $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name { $($(#[$field_meta])* pub $field: $type,)* }

        impl $crate::camera::fields::Field for $name {
            fn read(bytes: &mut &[u8]) -> Result<Self, $crate::camera::fields::FieldError> {
                Ok(Self { $($field: $crate::camera::fields::Field::read(bytes)?,)* })
            }

            fn write(&self, bytes: &mut Vec<u8>) {
                $($crate::camera::fields::Field::write(&self.$field, bytes);)*
            }
        }
    };
}

pub(crate) use wire_struct;

/// Longest text of an ERROR.
const TEXT_BYTES_MAX: usize = 512;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_that_is_cut_or_followed_by_more_is_malformed() {
        assert_eq!(u32::read_whole(&[1, 2, 3]), Err(FieldError::Malformed));
        assert_eq!(u16::read_whole(&[1, 2, 3]), Err(FieldError::Malformed));
        assert_eq!(Str8::read_whole(&[2, b'a']), Err(FieldError::Malformed));
        assert_eq!(Str8::read_whole(&[1, 0xFF]), Err(FieldError::Malformed));
        assert_eq!(Zero::<2>::read_whole(&[0, 1]), Err(FieldError::Reserved));
    }

    #[test]
    fn long_text_is_cut_between_characters() {
        let bytes = Str8("ä".repeat(200)).to_payload();
        assert_eq!(Str8::read_whole(&bytes), Ok(Str8("ä".repeat(127))));
    }
}
