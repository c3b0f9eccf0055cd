"""The page of a map, which the suffix .html asks for."""

from pathlib import Path

from occmap.page.document import write_page
from occmap.plugins import need_extra
from occmap.writers import OneFile, Product, WriteOptions


class HtmlWriter(OneFile):
    """One page with everything in it: the map, its layers, the way, and how it came about."""

    description = "page for any browser: the map in layers, the way, what was found"
    needs_evidence = True

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the file.

        Raises
        ------
        UsageError
            Bokeh, which is an extra, is not installed.
        """
        with need_extra("report", "a page is drawn by Bokeh", where=path):
            import bokeh  # noqa: F401, PLC0415  an extra
            import jinja2  # noqa: F401, PLC0415  likewise
        return super().targets(path)

    def write_product(
        self, path: Path, product: Product, options: WriteOptions
    ) -> tuple[Path, ...]:
        """Write the page; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        from occmap.page.product import describe_product  # noqa: PLC0415  late: it brings Bokeh

        write_page(path, describe_product(product, options))
        return (path,)
