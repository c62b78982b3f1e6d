# SPDX-License-Identifier: Apache-2.0
"""C++ types of .msg and .idl files, for cmake/messages.cmake.

    generate.py --root FOLDER... list FILE...              what is to be made: a line "pkg/msg/Type|header|file" for each type,
                                                           those that others need first
    generate.py --root FOLDER... --out FOLDER [--only HEADER...] [--max-bytes N] make FILE...
                                                           makes the headers, or some; one that would not change stays as it is

FILE: <package>/msg/<Type>.msg or .idl, below a --root, or a path that ends so. Types in fields are looked for below that path's own root
and the --roots. Python 3.8 and nothing but its standard library: it runs where an app is built, on whatever architecture."""
from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cpp_header
from idl_file import read_idl
from interface import Library, Refused
from msg_file import read_msg


def place(file, roots):
    """(root, pkg/msg/Type) of a file that was named."""
    named = Path(file)
    if named.suffix not in (".msg", ".idl") or len(named.parts) < 3:
        raise Refused(file, "is no <package>/msg/<Type>.msg or .idl")
    for candidate in [named] if named.is_absolute() else [root / named for root in roots]:
        if candidate.is_file():
            return candidate.parents[2], "/".join(candidate.with_suffix("").parts[-3:]), candidate
    raise Refused(file, f"is not below {', '.join(map(str, roots))}")


def main():
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("--root", action="append", type=Path, default=[])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", action="append", metavar="HEADER")
    parser.add_argument("--max-bytes", type=int)
    parser.add_argument("verb", choices=("list", "make"))
    parser.add_argument("files", nargs="+", metavar="FILE")
    options = parser.parse_args()
    if (options.out is None) == (options.verb == "make"):
        parser.error("make needs --out, list has none")
    try:
        places = [place(file, options.root) for file in options.files]
        roots = list(dict.fromkeys([root for root, _, _ in places] + options.root))
        library = Library(roots, {".msg": read_msg, ".idl": read_idl})
        named = [library.known.get(name) or library.read(name, path) for _, name, path in places]
        types = {m.full_name: m for message in named for m in library.needs(message)}
        for message in types.values():
            name = cpp_header.header_name(message)
            if options.verb == "list":
                print(f"{message.full_name}|{name}|{message.path}")
                continue
            if options.only and name not in options.only:
                continue
            path = options.out / name
            made = cpp_header.header(message, library, options.max_bytes if message in named else None)
            if path.is_file() and path.read_text(encoding="utf-8") == made:
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(made, encoding="utf-8")
    except Refused as error:
        sys.exit(f"{error}")
    except OSError as error:
        sys.exit(f"{error.filename}: {error.strerror}")


if __name__ == "__main__":
    main()
