//! Every file of the fuzzing corpus, and a few thousand mutations of each corpus, through its
//! parser: what `make fuzz` does at length, in seconds and on the stable toolchain.

use std::fs;
use std::path::Path;

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;

#[path = "../crates/raster/fuzz/src/lib.rs"]
#[expect(unreachable_pub, reason = "the library of the fuzz targets")]
mod parsers;

/// Mutations of each corpus.
const MUTATIONS: u32 = 20_000;

/// What parsers look for, and numbers at the edges.
const WORDS: [&[u8]; 24] = [
    b"\n",
    b"\r",
    b"\"",
    b",",
    b";",
    b"[",
    b"]",
    b"{",
    b"}",
    b"\\",
    b"\0",
    b"\x1b",
    b"\xff",
    b"\xef\xbb\xbf",
    b"-",
    b"nan",
    b"1e308",
    b"1e-320",
    b"-0.0",
    b"4294967296",
    b"-1",
    b"id",
    b"f ",
    b"\\u000a",
];

/// The corpus of a parser, in an order that does not depend on the file system.
fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let entries = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<_> = entries.map(|e| e.expect("readable").path()).collect();
    paths.sort();
    paths.iter().map(|p| fs::read(p).expect("readable")).collect()
}

fn below(rng: &mut Pcg32, n: usize) -> usize {
    rng.next_u32() as usize % n.max(1)
}

/// One to four changes: bits flipped, pieces cut, repeated, or taken from elsewhere.
fn mutated(seeds: &[Vec<u8>], rng: &mut Pcg32) -> Vec<u8> {
    let mut bytes = seeds[below(rng, seeds.len())].clone();
    for _ in 0..=below(rng, 4) {
        let at = below(rng, bytes.len() + 1);
        let to = at + below(rng, bytes.len() - at + 1);
        match below(rng, 6) {
            0 => bytes.truncate(at),
            1 if at < bytes.len() => bytes[at] ^= 1 << below(rng, 8),
            2 => drop(bytes.drain(at..to)),
            3 if bytes.len() < 4096 => bytes.extend_from_within(at..to),
            4 => {
                let other = &seeds[below(rng, seeds.len())];
                let from = below(rng, other.len() + 1);
                bytes.splice(at..to, other[from..].iter().copied());
            }
            _ => {
                let word = WORDS[below(rng, WORDS.len())];
                bytes.splice(at..at, word.iter().copied());
            }
        }
    }
    bytes
}

#[test]
fn every_parser_keeps_its_promises() {
    for (target, parse) in parsers::TARGETS {
        let seeds = corpus(target);
        assert!(!seeds.is_empty(), "{target}: an empty corpus would pass");
        let mut rng = Pcg32::new(1, 1);
        let mutations = (0..MUTATIONS).map(|_| mutated(&seeds, &mut rng));
        for bytes in seeds.iter().cloned().chain(mutations) {
            // The bytes belong in the message of a failure.
            let result = std::panic::catch_unwind(|| parse(&bytes));
            assert!(result.is_ok(), "{target}: \"{}\"", bytes.escape_ascii());
        }
    }
}

#[test]
fn every_corpus_belongs_to_a_parser() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for entry in fs::read_dir(folder).expect("the corpus") {
        let name = entry.expect("readable").file_name();
        assert!(parsers::TARGETS.iter().any(|(t, _)| name == *t), "{}", name.display());
    }
}
