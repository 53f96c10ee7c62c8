"""The frame of the report's page: its style, and where the parts go."""

from string import Template

PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light dark; --text: #1c1f24; --soft: #667; --line: #dde; --ground: #fff; --card: #f5f6f9; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e8ec; --soft: #99a; --line: #334; --ground: #14161a; --card: #1d2026; } }
body { margin: 0 auto; max-width: 1240px; padding: 2rem 1.5rem 4rem; background: var(--ground); color: var(--text);
       font: 15px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.5rem; margin: 0 0 .4rem; } h2 { font-size: 1.1rem; margin: 2.2rem 0 .6rem; } h3 { font-size: .95rem; margin: 1.2rem 0 .4rem; }
.headline { font-size: 1.1rem; background: var(--card); border-radius: 8px; padding: .8rem 1rem; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid var(--line); vertical-align: top; font-weight: normal; }
th { width: 19rem; } td { color: var(--soft); width: 2.5rem; } td:last-child { width: auto; } td.number { width: 5rem; color: var(--text); font-weight: 600; text-align: right; font-variant-numeric: tabular-nums; }
.row { display: grid; grid-template-columns: repeat(5, 1fr); gap: .7rem; }
figure { margin: 0; display: grid; grid-template-columns: 1fr 1fr; gap: 2px; } figcaption { grid-column: 1 / 3; color: var(--soft); }
figure img { width: 100%; display: block; border-radius: 2px; }
.none { background: var(--card); color: var(--soft); display: grid; place-items: center; aspect-ratio: 1; font-size: .8rem; }
@media (max-width: 900px) { .row { grid-template-columns: 1fr; } }
svg { max-width: 100%; height: auto; } pre { background: var(--card); padding: .8rem 1rem; border-radius: 8px; overflow-x: auto; }
ul { padding-left: 1.2rem; color: var(--soft); }
</style>
</head>
<body>
<h1>$title</h1>
<p class="headline">$headline</p>
<h2>Test views</h2>
<p>In each pair the truth is on the left, the rendering on the right.</p>
$views
<h2>Figures, mean over the test views</h2>
$figures
$mesh
$calibration
<h2>Error over time</h2>
$curve
<h2>What was done</h2>
<ul>$work</ul>
<pre>$commands</pre>
</body>
</html>
""")
