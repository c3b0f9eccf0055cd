"""Pages: what a command found, as one HTML file that opens anywhere, with no network.

Bokeh draws, its script being part of the page. What is large (the layers of a map, the hits of
scans) is compressed, and unpacked by the page when it is wanted.
"""
