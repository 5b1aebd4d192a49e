//! Opening an input: files, pipes, standard input, gzip; hashed on the way, never held in memory.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use flate2::read::MultiGzDecoder;
use sha2::{Digest, Sha256};

use crate::error::{Error, Place, Result};

/// One file that was read.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct InputFile {
    /// Path as given.
    pub path: String,
    /// `csv`, `bop-csv`, `bop-json`, `speed-csv`, `speed-json`, `obj`, `ply`, `stl`, `json`, `array`.
    pub format: String,
    /// SHA-256 of the bytes as read from disk, in hexadecimal.
    pub sha256: String,
    /// Size in bytes as read from disk.
    pub bytes: u64,
}

impl InputFile {
    /// The record of two files as one: the digest is that of both digests in hexadecimal.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let mut counter = Counter { bytes: self.bytes + other.bytes, ..Counter::default() };
        counter.sha256.update(self.sha256.as_bytes());
        counter.sha256.update(other.sha256.as_bytes());
        counter.record(self.path.clone(), &self.format)
    }

    /// The record of numbers in memory; the digest is that of their little-endian bytes.
    #[must_use]
    pub fn array(name: &str, numbers: impl Iterator<Item = f64>) -> Self {
        let mut counter = Counter::default();
        for x in numbers {
            counter.sha256.update(x.to_le_bytes());
            counter.bytes += 8;
        }
        counter.record(name.to_owned(), "array")
    }
}

/// JSON of poses beyond this is cut off, and so refused: a packed file may hold any amount.
pub(crate) const MAX_JSON: u64 = 1 << 30;

const BUFFER: usize = 1 << 18;

/// An open input and what is needed to talk about it.
pub struct Input {
    /// The name the user gave; `<stdin>` for `-`.
    pub name: String,
    reader: Box<dyn BufRead + Send>,
    path: PathBuf,
    digest: Arc<Mutex<Counter>>,
}

impl std::fmt::Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Input").field("name", &self.name).finish_non_exhaustive()
    }
}

#[derive(Default)]
struct Counter {
    sha256: Sha256,
    bytes: u64,
}

impl Counter {
    fn record(self, path: String, format: &str) -> InputFile {
        let mut sha256 = String::with_capacity(64);
        for byte in self.sha256.finalize() {
            // Writing to a string cannot fail.
            let _ = write!(sha256, "{byte:02x}");
        }
        InputFile { path, format: format.to_owned(), sha256, bytes: self.bytes }
    }
}

/// Hashes and counts what passes through, as it is on disk.
struct Tap<R> {
    inner: R,
    digest: Arc<Mutex<Counter>>,
}

impl<R: Read> Read for Tap<R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buf)?;
        let mut counter = self.digest.lock().unwrap_or_else(PoisonError::into_inner);
        counter.sha256.update(&buf[..n]);
        counter.bytes += n as u64;
        Ok(n)
    }
}

impl Input {
    /// Open a file, or standard input for `-`. Gzip is recognised by its first bytes. Pipes are
    /// read once, from the start to the end.
    ///
    /// # Errors
    /// [`Error::Read`]; a directory is refused by name.
    pub fn open(path: &Path) -> Result<Self> {
        if path == Path::new("-") {
            return Self::from_reader("<stdin>", path, io::stdin());
        }
        let read = |source| Error::Read { path: path.to_owned(), source };
        let file = File::open(path).map_err(read)?;
        if file.metadata().map_err(read)?.is_dir() {
            return Err(Error::Read {
                path: path.to_owned(),
                source: io::Error::new(io::ErrorKind::IsADirectory, "it is a directory"),
            });
        }
        Self::from_reader(&path.display().to_string(), path, file)
    }

    /// Bytes in memory under a name.
    ///
    /// # Errors
    /// As [`Input::open`].
    pub fn from_bytes(name: &str, bytes: Vec<u8>) -> Result<Self> {
        Self::from_reader(name, Path::new(name), io::Cursor::new(bytes))
    }

    fn from_reader(name: &str, path: &Path, inner: impl Read + Send + 'static) -> Result<Self> {
        let digest = Arc::new(Mutex::new(Counter::default()));
        let tap = Tap { inner, digest: Arc::clone(&digest) };
        let mut reader = BufReader::with_capacity(BUFFER, tap);
        let mut input = Self {
            name: name.to_owned(),
            path: path.to_owned(),
            digest,
            reader: Box::new(io::empty()),
        };
        let magic = reader.fill_buf().map_err(|e| input.read_error(e))?;
        let gzip = magic.starts_with(&[0x1f, 0x8b]);
        input.reader = if gzip {
            Box::new(BufReader::with_capacity(BUFFER, MultiGzDecoder::new(reader)))
        } else {
            Box::new(reader)
        };
        Ok(input)
    }

    /// The bytes available without consuming them; empty at the end of the input.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn peek(&mut self) -> Result<&[u8]> {
        let path = &self.path;
        let read = |source| Error::Read { path: path.clone(), source };
        self.reader.fill_buf().map_err(read)
    }

    /// Refuse what is no text at all, by its first bytes: a zip archive, UTF-16, a binary file.
    ///
    /// # Errors
    /// [`Error::Malformed`] saying what the file looks like.
    pub fn refuse_binary(&mut self) -> Result<()> {
        let name = self.name.clone();
        let head = self.peek()?;
        let found = if head.is_empty() {
            "an empty file"
        } else if head.starts_with(b"PK\x03\x04") {
            "a zip archive"
        } else if head.starts_with(&[0xff, 0xfe]) || head.starts_with(&[0xfe, 0xff]) {
            "UTF-16 text"
        } else if head.iter().take(4096).any(|&b| b == 0) {
            "binary data"
        } else if head.iter().take(4096).all(u8::is_ascii_whitespace) && head.len() < 4096 {
            "an empty file (white space only)"
        } else {
            return Ok(());
        };
        Err(Error::malformed(
            Place::file(&name),
            found,
            "UTF-8 text: a CSV file with a header line, or JSON",
        ))
    }

    /// Everything that is left.
    ///
    /// # Errors
    /// [`Error::Read`], also when more than `limit` bytes come.
    pub fn read_all(&mut self, limit: u64) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let result = (&mut self.reader).take(limit + 1).read_to_end(&mut bytes);
        result.map_err(|e| self.read_error(e))?;
        if bytes.len() as u64 > limit {
            let text = format!("it is larger than {} MiB", limit >> 20);
            return Err(self.read_error(io::Error::new(io::ErrorKind::FileTooLarge, text)));
        }
        Ok(bytes)
    }

    /// A place in this input.
    #[must_use]
    pub fn place(&self) -> Place {
        Place::file(&self.name)
    }

    fn read_error(&self, source: io::Error) -> Error {
        Error::Read { path: self.path.clone(), source }
    }

    /// What was read, for the record. The rest of the input is read first, so that the digest is
    /// that of the whole file.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn finish(mut self, format: &str) -> Result<InputFile> {
        let drained = io::copy(&mut self.reader, &mut io::sink());
        drained.map_err(|e| self.read_error(e))?;
        let mut counter = self.digest.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(std::mem::take(&mut *counter).record(self.path.display().to_string(), format))
    }
}

impl Read for Input {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        self.reader.read(buf)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn gzip_is_read_through_and_hashed_as_it_lies_on_disk() {
        let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        gz.write_all(b"id,qw\n").expect("in memory");
        let packed = gz.finish().expect("in memory");
        let size = packed.len() as u64;
        let mut input = Input::from_bytes("a.csv.gz", packed).expect("in memory");
        assert_eq!(input.read_all(100).expect("short"), b"id,qw\n");
        assert_eq!(input.finish("csv").expect("in memory").bytes, size);
    }

    #[test]
    fn the_digest_is_that_of_the_whole_input() {
        let input = Input::from_bytes("abc", b"abc".to_vec()).expect("in memory");
        let file = input.finish("csv").expect("in memory");
        assert!(file.sha256.starts_with("ba7816bf8f01cfea"), "{}", file.sha256);
    }

    #[test]
    fn what_is_no_text_is_named() {
        for (bytes, name) in [
            (&b""[..], "empty"),
            (b" \n \n", "empty"),
            (b"PK\x03\x04rest", "zip"),
            (b"\xff\xfei\0d\0", "UTF-16"),
            (b"\x00\x01\x02", "binary"),
        ] {
            let mut input = Input::from_bytes("x.csv", bytes.to_vec()).expect("in memory");
            let error = input.refuse_binary().expect_err("not text").to_string();
            assert!(error.starts_with("x.csv: found") && error.contains(name), "{error}");
        }
    }

    #[test]
    fn a_limit_bounds_what_is_read() {
        let mut input = Input::from_bytes("x", vec![b'a'; 100]).expect("in memory");
        assert!(input.read_all(99).is_err());
    }
}
