//! Reading a key: 32 bytes, raw or as 64 hexadecimal digits.
//!
//! As with plans only regular files are read, so that no program waits for a writer that never comes, and no more of them than
//! a key can have. No message shows what a file holds.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use powderline_shared::wire::auth::{KEY_BYTES, Key};
use thiserror::Error;

/// Most bytes of a key's file: the digits, and the end of their line.
const MAX_BYTES: u64 = 2 * KEY_BYTES as u64 + 2;

/// What makes a key.
const MAKE_ONE: &str = "`head -c 32 /dev/urandom > FILE` makes a key, for both ends";

/// Why a file is no key: one sentence that says what would be right.
#[derive(Debug, Error)]
pub enum KeyError {
    /// The operating system refuses it.
    #[error("{}: the key cannot be read: {error}; {MAKE_ONE}", path.display())]
    Io {
        /// As typed.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// It is a folder, a device, a pipe or a socket.
    #[error("{}: this is not a regular file; write the key's 32 bytes to a file and give that", path.display())]
    NotRegular {
        /// As typed.
        path: PathBuf,
    },
    /// It has neither the bytes nor the digits of a key.
    #[error("{}: this is no key: it has {bytes} bytes, and not 32, or 64 hexadecimal digits; {MAKE_ONE}", path.display())]
    Length {
        /// As typed.
        path: PathBuf,
        /// As many as there are.
        bytes: u64,
    },
    /// It is as long as 64 digits, and is something else.
    #[error(
        "{}: this is no key: it has 64 characters, of which number {place} is no hexadecimal digit (0 to 9, a to f)",
        path.display()
    )]
    Digit {
        /// As typed.
        path: PathBuf,
        /// Of the character, from 1.
        place: usize,
    },
}

/// The key in a file.
///
/// # Errors
/// What is wrong with the file.
pub fn read_key_file(path: &Path) -> Result<Key, KeyError> {
    let io = |error| KeyError::Io { path: path.to_owned(), error };
    let metadata = path.metadata().map_err(io)?;
    if !metadata.is_file() {
        return Err(KeyError::NotRegular { path: path.to_owned() });
    }
    let wrong = |bytes| KeyError::Length { path: path.to_owned(), bytes };
    if metadata.len() > MAX_BYTES {
        return Err(wrong(metadata.len()));
    }
    let mut bytes = Vec::new();
    // Should the file grow meanwhile, it is not read for ever.
    File::open(path)
        .and_then(|file| file.take(MAX_BYTES.saturating_add(1)).read_to_end(&mut bytes))
        .map_err(io)?;
    if let Ok(raw) = <&[u8; KEY_BYTES]>::try_from(&*bytes) {
        return Ok(Key::new(raw));
    }
    let digits = bytes.strip_suffix(b"\n").unwrap_or(&bytes);
    let digits = digits.strip_suffix(b"\r").unwrap_or(digits);
    let (pairs, rest) = digits.as_chunks::<2>();
    if pairs.len() != KEY_BYTES || !rest.is_empty() {
        return Err(wrong(bytes.len() as u64));
    }
    from_digits(pairs)
        .map(|raw| Key::new(&raw))
        .map_err(|place| KeyError::Digit { path: path.to_owned(), place })
}

/// The bytes; or the place of the first character that is no digit, from 1.
fn from_digits(pairs: &[[u8; 2]]) -> Result<[u8; KEY_BYTES], usize> {
    let digit = |digit: u8, place: usize| {
        let value = char::from(digit).to_digit(16).and_then(|value| u8::try_from(value).ok());
        value.ok_or(place)
    };
    let mut raw = [0; KEY_BYTES];
    for (byte, ([high, low], place)) in raw.iter_mut().zip(pairs.iter().zip((1_usize..).step_by(2))) {
        *byte = digit(*high, place)? << 4 | digit(*low, place.saturating_add(1))?;
    }
    Ok(raw)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    use std::fs;

    const HEX: &str = "000102030405060708090A0b0c0d0e0f101112131415161718191a1b1c1d1e1f";

    #[test]
    fn bytes_and_digits_are_the_same_key() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        let raw: [u8; KEY_BYTES] = std::array::from_fn(|at| u8::try_from(at).unwrap());
        for content in [raw.to_vec(), HEX.into(), format!("{HEX}\n").into(), format!("{HEX}\r\n").into()] {
            fs::write(&path, content).unwrap();
            assert_eq!(read_key_file(&path).unwrap(), Key::new(&raw));
        }
    }

    #[test]
    fn what_is_no_key_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        let make = "`head -c 32 /dev/urandom > FILE` makes a key, for both ends";
        let said = || read_key_file(&path).unwrap_err().to_string();
        let shown = path.display().to_string();
        let missing =
            format!("{shown}: the key cannot be read: No such file or directory (os error 2); {make}");
        assert_eq!(said(), missing);
        for bytes in [0, 31, 33, 63, 65, 66, 67, 1_000_000] {
            fs::write(&path, vec![b'a'; bytes]).unwrap();
            let expected = format!(
                "{shown}: this is no key: it has {bytes} bytes, and not 32, or 64 hexadecimal digits; {make}"
            );
            assert_eq!(said(), expected);
        }
        fs::write(&path, HEX.replace("1e", "1g")).unwrap();
        let expected = "this is no key: it has 64 characters, of which number 62 is no hexadecimal digit (0 to 9, a to f)";
        assert_eq!(said(), format!("{shown}: {expected}"));
        fs::remove_file(&path).unwrap();
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        let regular = "this is not a regular file; write the key's 32 bytes to a file and give that";
        assert_eq!(said(), format!("{shown}: {regular}"));
        assert!(read_key_file(dir.path()).unwrap_err().to_string().ends_with(regular));
    }
}
