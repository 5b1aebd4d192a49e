//! Tests of [`super`].

use proptest::prelude::*;

use super::*;

fn read(bytes: &[u8]) -> Result<Vec<(u64, Vec<String>)>> {
    let mut records = Records::new(Input::from_bytes("x.csv", bytes.to_vec())?)?;
    let mut out = Vec::new();
    while let Some(record) = records.next_record()? {
        let mut fields = Vec::new();
        record.split_into(&mut fields);
        let text = |f: &&[u8]| text(f).map_or("<not UTF-8>".into(), std::borrow::Cow::into_owned);
        out.push((record.line, fields.iter().map(text).collect()));
    }
    Ok(out)
}

fn row(line: u64, fields: &[&str]) -> (u64, Vec<String>) {
    (line, fields.iter().map(|&f| f.into()).collect())
}

#[test]
fn lines_are_physical_and_blank_ones_count() {
    let rows = read(b"\xef\xbb\xbfa,b\r\n\r\n \n1, 2 \n\"x\ny\",3\nz,4").expect("sound");
    let expected =
        [row(1, &["a", "b"]), row(4, &["1", "2"]), row(5, &["x\ny", "3"]), row(7, &["z", "4"])];
    assert_eq!(rows, expected);
}

#[test]
fn every_line_end_is_a_line_end() {
    for text in ["a\nb\nc\n", "a\r\nb\r\nc", "a\rb\rc\r", "a\nb\r\nc\r"] {
        let rows = read(text.as_bytes()).expect("sound");
        assert_eq!(rows, [row(1, &["a"]), row(2, &["b"]), row(3, &["c"])], "{text:?}");
    }
}

#[test]
fn quotes_follow_rfc_4180() {
    let rows = read(b"\"a,b\", \"say \"\"hi\"\"\" ,\"\",c").expect("sound");
    assert_eq!(rows, [row(1, &["a,b", "say \"hi\"", "", "c"])]);
}

#[test]
fn an_unclosed_quote_names_the_line_where_it_opens() {
    let error = read(b"a\n1\n2,\"b\n3\n4\n").expect_err("unclosed").to_string();
    assert!(error.starts_with("x.csv:3:field 2: found a quote that is never closed"), "{error}");
    let mut long = b"\"".to_vec();
    long.extend(std::iter::repeat_n(*b"abcdefg\n", 1 << 18).flatten());
    assert!(read(&long).is_err());
}

#[test]
fn a_quote_in_the_middle_of_a_field_is_refused() {
    assert!(read(b"ab\"c\"").is_err());
    assert!(read(b"\"ab\"c").is_err());
}

/// As [`read`], with lines taken ahead `size` bytes at a time where that is possible.
fn read_ahead(bytes: &[u8], size: usize) -> Result<Vec<(u64, Vec<String>)>> {
    let mut records = Records::new(Input::from_bytes("x.csv", bytes.to_vec())?)?;
    let (mut out, mut lines) = (Vec::new(), Vec::new());
    let strings = |record: &Record<'_>| {
        let mut fields = Vec::new();
        record.split_into(&mut fields);
        let text = |f: &&[u8]| text(f).map_or("<not UTF-8>".into(), std::borrow::Cow::into_owned);
        fields.iter().map(text).collect::<Vec<_>>()
    };
    while records.take_lines(size, &mut lines) {
        let (before, mut rows) = (records.line, Vec::new());
        let read = plain_records(&lines, |record| {
            rows.push((before + record.line, strings(&record)));
            Some(())
        });
        let Some(count) = read else {
            records.unread(&lines);
            break;
        };
        records.used(count);
        out.append(&mut rows);
    }
    while let Some(record) = records.next_record()? {
        out.push((record.line, strings(&record)));
    }
    Ok(out)
}

#[test]
fn a_line_of_ten_megabytes_is_read() {
    let mut line = vec![b'1'; 10 << 20];
    line.extend_from_slice(b",2\n3\n");
    let rows = read(&line).expect("long but sound");
    assert_eq!((rows.len(), rows[0].1.len()), (2, 2));
}

#[test]
fn endless_blank_lines_are_refused() {
    let text = [&b"a\n"[..], &vec![b'\n'; MAX_BLANK as usize], &b"\nb\n"[..]].concat();
    let error = read(&text).expect_err("too many").to_string();
    assert!(error.starts_with("x.csv:2: found more than 10000000 blank lines"), "{error}");
}

#[test]
fn a_line_of_commas_is_refused() {
    let commas = |n: usize| [&b"a,b\n"[..], &vec![b','; n], &b"\n"[..]].concat();
    assert_eq!(read(&commas(MAX_FIELDS - 1)).expect("wide")[1].1.len(), MAX_FIELDS);
    let error = read(&commas(MAX_FIELDS)).expect_err("too wide").to_string();
    assert_eq!(error, "x.csv:2: found more than 100000 fields, expected a table of poses");
    let quoted = [&b"\"a\""[..], &vec![b','; MAX_FIELDS]].concat();
    assert!(read(&quoted).is_err());
    let inside = [&b"\""[..], &vec![b','; MAX_FIELDS], &b"\",b"[..]].concat();
    assert_eq!(read(&inside).expect("two fields")[0].1.len(), 2);
}

proptest! {
    #[test]
    fn nothing_panics(bytes in prop::collection::vec(prop_oneof![Just(b'"'), Just(b','), Just(b'\n'), Just(b'\r'), any::<u8>()], 0..200)) {
        let _ = read(&bytes);
    }

    #[test]
    fn reading_ahead_changes_nothing(
        bytes in prop::collection::vec(prop_oneof![3 => Just(b'a'), 2 => Just(b','), 3 => Just(b'\n'), 1 => Just(b'\r'), 1 => Just(b' '), 1 => Just(b'"')], 0..80),
        size in 1_usize..30,
    ) {
        let show = |rows: Result<Vec<_>>| rows.map_err(|e| e.to_string());
        prop_assert_eq!(show(read_ahead(&bytes, size)), show(read(&bytes)));
        let plain: Vec<u8> = bytes.into_iter().filter(|b| !matches!(b, b'"' | b'\r')).collect();
        prop_assert_eq!(show(read_ahead(&plain, size)), show(read(&plain)));
    }

    #[test]
    fn plain_fields_survive(rows in prop::collection::vec(prop::collection::vec("[a-z0-9.]{1,8}", 1..5), 1..20)) {
        let text = rows.iter().map(|r| r.join(",")).collect::<Vec<_>>().join("\n");
        let got: Vec<_> = read(text.as_bytes()).expect("sound").into_iter().map(|r| r.1).collect();
        prop_assert_eq!(got, rows);
    }
}
