//! Tests of [`super`].

use std::fmt::Write;

use proptest::prelude::*;

use super::*;

#[test]
fn a_header_cannot_steer_the_terminal() {
    let text = b"id,qw,qx,q\x1by,qz,tx,ty,tz\n1,1,0,0,0,0,0,1\n".to_vec();
    let input = Input::from_bytes("a.csv", text).expect("in memory");
    let options = CsvOptions { unit: Unit::Metre, keep: &[] };
    let error = read_pose_csv(input, options).expect_err("refused").to_string();
    assert!(error.ends_with("a column 'qy' (is 'q\\u{1b}y' meant?)"), "{error}");
}

const ROWS: u32 = 60_000; // several pieces, several blocks with few threads

/// Rows of which row `odd` is written differently.
fn rows(odd: u32, written: &str) -> String {
    let mut text = String::from("id,qw,qx,qy,qz,tx,ty,tz\n");
    for i in 0..ROWS {
        if i == odd {
            text.push_str(written);
        } else {
            writeln!(text, "{i},1,0,0,0.{i},0,0,{i}.5").expect("a string");
        }
    }
    text
}

fn read(text: &str, threads: usize) -> Result<PoseTable> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    let input = Input::from_bytes("x.csv", text.as_bytes().to_vec())?;
    pool.install(|| read_pose_csv(input, CsvOptions { unit: Unit::Metre, keep: &[] }))
}

#[test]
fn threads_and_odd_rows_change_nothing() {
    let odd = "\"a\"\"b\n\",2,0,0,0,0,0,7.5\r\n\r\n\n";
    for (text, after) in [(rows(ROWS, ""), 0), (rows(40_000, odd), 3)] {
        let tables = [1, 2, 5].map(|threads| read(&text, threads).expect("sound"));
        for table in &tables {
            assert_eq!(table.len(), ROWS as usize);
            assert_eq!((table.ids.get(39_999), table.lines[39_999]), ("39999", 40_001));
            let last = ROWS as usize - 1;
            assert_eq!((table.ids.get(last), table.lines[last]), ("59999", ROWS + 1 + after));
            assert_eq!(table.poses, tables[0].poses);
            assert_eq!(table.warnings, tables[0].warnings);
            assert_eq!(table.source, tables[0].source);
        }
    }
}

#[test]
fn the_first_error_is_the_one_reported() {
    let mut text = rows(50_000, "50000,1,0,0,0,0,x,1\n");
    for threads in [1, 2, 5] {
        let error = read(&text, threads).expect_err("a letter").to_string();
        assert!(error.starts_with("x.csv:50002:ty: found 'x'"), "{error}");
    }
    text.insert_str(text.find("\n100,").expect("a row") + 1, "\n,1,0,0,0,0,0,1\n");
    for threads in [1, 5] {
        let error = read(&text, threads).expect_err("no id").to_string();
        assert!(error.starts_with("x.csv:103:id: found an empty id"), "{error}");
    }
}

#[test]
fn the_worst_norm_has_its_line() {
    let text = rows(30_000, "a,3,0,0,0,0,0,1\n");
    for threads in [1, 5] {
        let table = read(&text, threads).expect("sound");
        let warning = "x.csv:30002:qw..qz: quaternion of norm 3.000000 here";
        assert!(table.warnings[0].starts_with(warning), "{:?}", table.warnings);
    }
}

proptest! {
    #[test]
    fn numbers_are_those_of_the_standard_library(
        bits in any::<u64>(),
        digits in "[-+]?[0-9]{0,25}[.]?[0-9]{0,25}([eE][-+]?[0-9]{1,3})?",
        any in "[-+.eE0-9a-z_ ]{0,6}",
    ) {
        let shortest = f64::from_bits(bits).to_string();
        for text in [shortest, digits, any] {
            let ours = number(text.as_bytes(), || Place::file("x")).ok().map(f64::to_bits);
            let theirs = text.parse::<f64>().ok().filter(|x| x.is_finite()).map(f64::to_bits);
            prop_assert_eq!(ours, theirs, "{}", text);
        }
    }
}
