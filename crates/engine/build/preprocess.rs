//! The shader preprocessor: imports, conditions, unrolling and float accumulation, line by line.
//!
//! - `#import name`: the text of file `name` in `shaders/shared/`, at most once per shader; for `generated/name` see
//!   `build/generated.rs`.
//! - `#ifdef X`, `#ifndef X`, `#else`, `#endif`: conditions on X, a define of the permutation.
//! - `#repeat k COUNT` ... `#end`: the lines COUNT times, `$k` replaced by 0, 1, ...; COUNT is a number or a define.
//! - `accumulate!(target, value);` on a line of its own: atomic float addition to an element of type `accumulator`.

use std::collections::{BTreeMap, BTreeSet};

/// Implementation of `accumulate!`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Accumulation {
    /// Native float atomics.
    Native,
    /// A compare-exchange loop on the bits, for devices without float atomics.
    CompareExchange,
}

/// One line of `permutations.txt`: a compiled shader.
#[derive(Debug, Clone, PartialEq)]
pub struct Permutation {
    /// Name of the Rust constant.
    pub name: String,
    /// The entry file, without extension.
    pub file: String,
    /// Defines; one with a value also becomes a WGSL constant.
    pub defines: BTreeMap<String, Option<u32>>,
}

/// Parses `permutations.txt`: `NAME = file[: DEFINE DEFINE=3 ...]`, `//` comments.
pub fn parse_permutations(text: &str) -> Result<Vec<Permutation>, String> {
    let lines = text.lines().map(|l| l.split("//").next().unwrap_or("").trim());
    lines.filter(|l| !l.is_empty()).map(parse_permutation).collect()
}

fn parse_permutation(line: &str) -> Result<Permutation, String> {
    let (name, rest) = line.split_once('=').ok_or_else(|| format!("`{line}`: expected NAME = file"))?;
    let (file, defines) = rest.split_once(':').unwrap_or((rest, ""));
    let define = |word: &str| match word.split_once('=') {
        None => Ok((word.to_owned(), None)),
        Some((key, value)) => {
            let value = value.parse().map_err(|_| format!("`{line}`: {key} is no number"))?;
            Ok((key.to_owned(), Some(value)))
        }
    };
    Ok(Permutation {
        name: name.trim().to_owned(),
        file: file.trim().to_owned(),
        defines: defines.split_whitespace().map(define).collect::<Result<_, String>>()?,
    })
}

/// Expands `source`; `import` returns the text of a shared piece.
pub fn expand(
    source: &str,
    defines: &BTreeMap<String, Option<u32>>,
    accumulation: Accumulation,
    import: &dyn Fn(&str) -> Result<String, String>,
) -> Result<String, String> {
    let mut out = String::new();
    for (name, value) in defines {
        if let Some(value) = value {
            out.push_str(&format!("const {name} = {value}u;\n"));
        }
    }
    let mut imported = BTreeSet::new();
    let lines = conditional_lines(source, defines, import, &mut imported)?;
    for line in unroll(&lines, defines)? {
        out.push_str(&accumulate(&line, accumulation)?);
        out.push('\n');
    }
    Ok(out)
}

/// Resolves imports and conditions.
fn conditional_lines(
    source: &str,
    defines: &BTreeMap<String, Option<u32>>,
    import: &dyn Fn(&str) -> Result<String, String>,
    imported: &mut BTreeSet<String>,
) -> Result<Vec<String>, String> {
    let mut out = Vec::new();
    let mut active: Vec<bool> = Vec::new();
    for line in source.lines() {
        let mut words = line.split_whitespace();
        let (directive, argument) = (words.next().unwrap_or(""), words.next().unwrap_or(""));
        match directive {
            "#ifdef" => active.push(defines.contains_key(argument)),
            "#ifndef" => active.push(!defines.contains_key(argument)),
            "#else" => {
                let last = active.last_mut().ok_or("#else without #ifdef")?;
                *last = !*last;
            }
            "#endif" => {
                active.pop().ok_or("#endif without #ifdef")?;
            }
            _ if active.contains(&false) => {}
            "#import" => {
                if imported.insert(argument.to_owned()) {
                    let text = import(argument)?;
                    out.extend(conditional_lines(&text, defines, import, imported)?);
                }
            }
            _ => out.push(line.to_owned()),
        }
    }
    if active.is_empty() { Ok(out) } else { Err("#ifdef without #endif".to_owned()) }
}

/// Copies the body of each `#repeat`; repeats may nest.
fn unroll(lines: &[String], defines: &BTreeMap<String, Option<u32>>) -> Result<Vec<String>, String> {
    let mut out = Vec::new();
    let mut at = 0;
    while at < lines.len() {
        let words: Vec<&str> = lines[at].split_whitespace().collect();
        if words.first() != Some(&"#repeat") {
            if words.first() == Some(&"#end") {
                return Err("#end without #repeat".to_owned());
            }
            out.push(lines[at].clone());
            at += 1;
            continue;
        }
        let [_, variable, count] = words[..] else {
            return Err(format!("`{}`: expected #repeat k COUNT", lines[at]));
        };
        let count = match count.parse::<u32>() {
            Ok(count) => count,
            Err(_) => defines
                .get(count)
                .copied()
                .flatten()
                .ok_or_else(|| format!("#repeat: {count} has no value"))?,
        };
        let end = matching_end(lines, at)?;
        for k in 0..count {
            let pattern = format!("${variable}");
            let body: Vec<String> =
                lines[at + 1..end].iter().map(|l| l.replace(&pattern, &k.to_string())).collect();
            out.extend(unroll(&body, defines)?);
        }
        at = end + 1;
    }
    Ok(out)
}

fn matching_end(lines: &[String], start: usize) -> Result<usize, String> {
    let mut depth = 0;
    for (at, line) in lines.iter().enumerate().skip(start) {
        match line.split_whitespace().next() {
            Some("#repeat") => depth += 1,
            Some("#end") => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Ok(at);
        }
    }
    Err("#repeat without #end".to_owned())
}

/// Rewrites the element type and the statement of float accumulation.
fn accumulate(line: &str, accumulation: Accumulation) -> Result<String, String> {
    let native = accumulation == Accumulation::Native;
    let element = if native { "array<atomic<f32>>" } else { "array<atomic<u32>>" };
    let line = line.replace("array<accumulator>", element);
    let Some(statement) = line.trim().strip_prefix("accumulate!(") else { return Ok(line) };
    let inside = statement.strip_suffix(");").ok_or_else(|| format!("`{line}`: must end with `);`"))?;
    let comma = top_level_comma(inside).ok_or_else(|| format!("`{line}`: expected target, value"))?;
    let (target, value) = (&inside[..comma], inside[comma + 1..].trim());
    Ok(if native {
        format!("atomicAdd(&{target}, {value});")
    } else {
        format!(
            "{{ let sum_value = {value}; var sum_old = atomicLoad(&{target}); loop {{ \
             let sum_try = atomicCompareExchangeWeak(&{target}, sum_old, bitcast<u32>(bitcast<f32>(sum_old) + sum_value)); \
             if sum_try.exchanged {{ break; }} sum_old = sum_try.old_value; }} }}"
        )
    })
}

/// The first comma outside all brackets.
fn top_level_comma(text: &str) -> Option<usize> {
    let mut depth = 0;
    text.char_indices().find_map(|(at, c)| {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth -= 1,
            _ => {}
        }
        (c == ',' && depth == 0).then_some(at)
    })
}
