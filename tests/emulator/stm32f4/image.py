"""The program as the linker left it."""

from elftools.elf.elffile import ELFFile


class Image:
    """Loadable bytes and symbols of an ELF file."""

    def __init__(self, path):
        self.path = str(path)
        with open(path, "rb") as file:
            elf = ELFFile(file)
            self.segments = [(s["p_paddr"], s.data()) for s in elf.iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"]]
            table = elf.get_section_by_name(".symtab")
            self.symbols = {}
            self._functions = []
            for symbol in table.iter_symbols() if table else ():
                if symbol["st_info"]["type"] == "STT_FUNC":
                    self._functions.append((symbol["st_value"] & ~1, symbol["st_size"], symbol.name))
                if symbol.name:
                    self.symbols[symbol.name] = symbol["st_value"]
            self._functions.sort()

    @classmethod
    def of_bytes(cls, segments):
        """A program without an ELF file: [(address, bytes)]."""
        self = cls.__new__(cls)
        self.path, self.segments, self.symbols, self._functions = "", segments, {}, []
        return self

    def function_at(self, address):
        """The name of the function around an address, its number in hexadecimal if there is none."""
        for start, size, name in reversed(self._functions):
            if start <= address:
                return name if address < start + max(size, 2) else f"{address:#010x}"
        return f"{address:#010x}"
