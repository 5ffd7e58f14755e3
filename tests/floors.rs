//! Holds the floors of `ARCHITECTURE.md`: a floor uses only floors below it, and floors 0 to 3 do no I/O.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The floor of each top-level module of the library.
const FLOORS: &[(&str, u8)] = &[
    ("geometry", 0),
    ("event", 0),
    ("fault", 0),
    ("seed", 0),
    ("stamp", 0),
    ("cleaning", 1),
    ("registration", 1),
    ("reconstruction", 1),
    ("robot", 2),
    ("camera", 2),
    ("settings", 2),
    ("plan", 3),
    ("job", 3),
    ("session", 3),
    ("controller", 3),
    ("journal", 3),
    ("run", 4),
    ("cli", 5),
];

/// Modules of one floor that a module of the same floor may use, so that peers never form a circle.
const PEERS: &[(&str, &[&str])] = &[
    ("event", &["fault", "geometry"]),
    ("reconstruction", &["registration"]),
    ("settings", &["robot"]),
    ("session", &["plan"]),
    ("controller", &["session", "plan", "job"]),
    ("journal", &["controller", "job"]),
];

/// What floors 0 to 3 never name.
const FORBIDDEN_BELOW_4: &[&str] = &[
    "tokio",
    "std::net",
    "std::fs",
    "std::process",
    "std::env",
    "std::thread",
    "std::io::std",
    "Instant",
    "SystemTime",
    "thread_rng",
    "rand::rng()",
    "HashMap",
    "HashSet",
];

fn sources(dir: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Each file of the library with its top-level module and its code: comments and test modules left out.
fn library() -> Vec<(String, String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    files
        .iter()
        .filter_map(|path| {
            let inside = path.strip_prefix(&root).unwrap();
            let module = inside
                .iter()
                .next()
                .unwrap()
                .to_str()
                .unwrap()
                .trim_end_matches(".rs")
                .to_owned();
            if matches!(module.as_str(), "lib" | "main" | "vectors") || is_test(inside) {
                return None;
            }
            let text = std::fs::read_to_string(path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
            let code: Vec<&str> = code
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"))
                .collect();
            Some((module, inside.display().to_string(), code.join("\n")))
        })
        .collect()
}

fn is_test(inside: &Path) -> bool {
    inside.ends_with("tests.rs") || inside.iter().any(|part| part == "tests")
}

fn floor_of(module: &str) -> u8 {
    FLOORS
        .iter()
        .find(|(name, _)| *name == module)
        .unwrap_or_else(|| panic!("module {module} has no floor: add it to FLOORS and to ARCHITECTURE.md"))
        .1
}

/// Top-level modules that the code names as `crate::NAME` or in a `use crate::{...}`.
fn used_modules(code: &str) -> Vec<String> {
    let mut used = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let name: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        assert!(!rest.starts_with('{'), "write one `use crate::module::...` a line");
        used.push(name);
    }
    used
}

#[test]
fn a_floor_uses_only_floors_below_it() {
    let peers: BTreeMap<_, _> = PEERS.iter().copied().collect();
    let mut wrong = Vec::new();
    for (module, file, code) in library() {
        for used in used_modules(&code) {
            if used == module {
                continue;
            }
            let allowed = floor_of(&used) < floor_of(&module)
                || peers
                    .get(module.as_str())
                    .is_some_and(|peers| peers.contains(&used.as_str()));
            if !allowed {
                wrong.push(format!("{file} uses {used}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn floors_0_to_3_do_no_io_and_read_no_clock() {
    let mut wrong = Vec::new();
    for (module, file, code) in library() {
        if floor_of(&module) > 3 {
            continue;
        }
        for word in FORBIDDEN_BELOW_4 {
            if code.contains(word) {
                wrong.push(format!("{file} names {word}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn only_the_command_line_names_the_simulator() {
    for (module, file, code) in library() {
        assert!(module == "cli" || !code.contains("hw_sim"), "{file} names hw_sim");
    }
}

#[test]
fn the_simulator_never_names_bladescan() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("hw-sim");
    let mut files = Vec::new();
    sources(&root.join("src"), &mut files);
    for path in &files {
        let text = std::fs::read_to_string(path).unwrap();
        assert!(!text.contains("bladescan::"), "{} names bladescan", path.display());
    }
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    assert!(!manifest.contains("\nbladescan"), "hw-sim depends on bladescan");
}

#[test]
fn no_file_is_longer_than_600_lines() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for dir in ["src", "tests", "hw-sim/src", "experiments/src"] {
        sources(&root.join(dir), &mut files);
    }
    for path in files {
        let count = std::fs::read_to_string(&path).unwrap().lines().count();
        assert!(count <= 600, "{} has {count} lines", path.display());
    }
}
