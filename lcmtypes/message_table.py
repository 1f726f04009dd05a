#!/usr/bin/env python3
"""Makes message_table.h and message_table.cc of the .lcm files: the names of message types, their
fingerprints and a walk over the fields that checks the size of a message.

usage: message_table.py OUT_FOLDER FILE.lcm..
"""

import pathlib
import re
import sys

SIZES = {'int8_t': 1, 'byte': 1, 'boolean': 1, 'int16_t': 2, 'int32_t': 4, 'float': 4,
         'int64_t': 8, 'double': 8}
# Messages of Michigan's stacks have a package in some and none in others.
WITHOUT_PACKAGE = {'michigan'}


class Struct:
    def __init__(self, path):
        text = re.sub(r'//.*', '', pathlib.Path(path).read_text())
        self.package = re.search(r'package\s+(\w+)', text)[1]
        self.name, body = re.search(r'struct\s+(\w+)\s*\{(.*)\}', text, re.S).groups()
        self.fields = []  # (type, name, dimensions)
        for field in filter(None, map(str.strip, body.split(';'))):
            type_name, declared = field.split(None, 1)
            name, dimensions = re.fullmatch(r'(\w+)((?:\[\w+\])*)', declared).groups()
            self.fields.append((type_name, name, re.findall(r'\w+', dimensions)))

    def enumerator(self):
        return 'k' + ''.join(word.capitalize() for word in self.name.removesuffix('_t').split('_'))

    def shown_name(self):
        return self.name if self.package in WITHOUT_PACKAGE else f'{self.package}.{self.name}'

    def walk(self):
        counts = {d for _, _, dimensions in self.fields for d in dimensions if not d.isdigit()}
        lines = []
        for type_name, name, dimensions in self.fields:
            if name in counts:
                lines.append(f'const size_t {name} = walk.Count();')
                continue
            number = ' * '.join(f'size_t{{{d}}}' for d in dimensions)
            if type_name in SIZES:
                size = SIZES[type_name]
                lines.append(f'walk.Skip({number} * {size});' if number else f'walk.Skip({size});')
                continue
            step = 'walk.String();' if type_name == 'string' else f'{walk_name(type_name)}(walk);'
            if number:
                step = f'for (size_t k = 0; walk.fits() && k < {number}; ++k) {step}'
            lines.append(step)
        body = ''.join(f'  {line}\n' for line in lines)
        return f'void {walk_name(self.name)}([[maybe_unused]] SizeWalk& walk) {{\n{body}}}\n'


def walk_name(name):
    return 'Walk' + ''.join(word.capitalize() for word in name.split('.')[-1].split('_')[:-1])


def main():
    out, *paths = sys.argv[1:]
    structs = [Struct(path) for path in paths]
    # Those without parts of their own first.
    def depth(s):
        by_name = {f'{o.package}.{o.name}': o for o in structs} | {o.name: o for o in structs}
        return 1 + max((depth(by_name[t]) for t, _, _ in s.fields if t in by_name), default=0)
    in_order = sorted(structs, key=depth)

    pathlib.Path(out, 'message_table.h').write_text(
        '#pragma once\n\nnamespace splinemap {\n\n'
        '// The types that splinemap knows, one for each .lcm file.\nenum class MessageType {\n'
        + ''.join(f'  {s.enumerator()},\n' for s in structs) + '};\n\n}  // namespace splinemap\n')

    cc = ['#include "lib/wire/message_info.h"\n']
    cc += [f'#include "lcmtypes/{s.package}/{s.name}.hpp"\n' for s in structs]
    cc.append('\nnamespace splinemap {\nnamespace {\n\n')
    cc += [s.walk() + '\n' for s in in_order]
    cc.append('}  // namespace\n\nconst std::vector<MessageInfo>& MessageInfos() {\n'
              '  static const std::vector<MessageInfo> kInfos{\n')
    for s in structs:
        scope = '' if s.package == 'splinemap' else s.package + '::'
        cc.append(f'      {{MessageType::{s.enumerator()}, "{s.shown_name()}", '
                  f'{scope}{s.name}::getHash(), &{walk_name(s.name)}}},\n')
    cc.append('  };\n  return kInfos;\n}\n\n}  // namespace splinemap\n')
    pathlib.Path(out, 'message_table.cc').write_text(''.join(cc))


main()
