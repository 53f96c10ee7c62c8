"""Fully connected layers with ReLU between them as compiled loops; see `reconstruct.kernels.network`.

Arrays of a call: inputs (channels, n), then of each layer its weights (outputs, inputs) and biases (outputs,), and on the way
back the cotangents of the results: values (outputs, n) and, where it was asked for, sensitivity (channels, n).

On the way there a block of points is a column of each matrix, on the way back a row: then every product adds whole rows, and
nothing is transposed but what comes in and goes out.
"""

import numpy as np

from koala3d.reconstruct.kernels.loops.chunks import address_of, in_chunks_of
from koala3d.reconstruct.kernels.loops.compiler import compiled, handler, plain
from koala3d.reconstruct.kernels.loops.frame import (
    argument,
    argument_count,
    argument_size,
    executes,
    result,
    result_count,
    result_size,
)
from koala3d.reconstruct.kernels.loops.product import add_product, address
from koala3d.reconstruct.kernels.network import CHUNK, LANES, ROWS, padded

BLOCK = 64
"""Points of a block."""
f4 = np.float32
_padded = plain(padded)


@compiled
def _widths(frame, layers):
    """Channels of the inputs, and outputs of each layer."""
    widths = np.empty(layers + 1, np.int64)
    widths[0] = argument_size(frame, 0, 0)
    for layer in range(layers):
        widths[layer + 1] = argument_size(frame, 1 + 2 * layer, 0)
    return widths


@compiled
def _weights(frame, layer, widths):
    """Weights and biases of a layer."""
    into, out = widths[layer], widths[layer + 1]
    return argument(frame, 1 + 2 * layer, (out, into), np.float32), argument(frame, 2 + 2 * layer, (out,), np.float32)


@compiled
def _clear(block, rows, columns):
    for row in range(rows):
        cleared = block[row]
        for column in range(columns):
            cleared[column] = f4(0)


@compiled
def _copy(source, target, count):
    """The first numbers of one row into another."""
    for i in range(count):
        target[i] = source[i]


@compiled
def _take_columns(array, first, count, block):
    """Columns of an array into the first rows and columns of a block; zeros for points that there are not."""
    for row in range(array.shape[0]):
        _copy(array[row, first:], block[row], count)
        missing = block[row, count:]
        for point in range(BLOCK - count):
            missing[point] = f4(0)


@compiled
def _relu(block, rows, columns):
    for row in range(rows):
        values = block[row]
        for column in range(columns):
            values[column] = max(values[column], f4(0))


@compiled
def _padded_weights(frame, widths):
    """Weights of each layer as they are, with zeros for further rows."""
    layers, widest = widths.shape[0] - 1, _padded(widths.max(), ROWS)
    rows = np.zeros((layers, widest * widest + ROWS), f4)
    for layer in range(layers):
        weights, _ = _weights(frame, layer, widths)
        for out in range(weights.shape[0]):
            for into in range(weights.shape[1]):
                rows[layer, out * weights.shape[1] + into] = weights[out, into]
    return rows


@compiled
def _layer_there(weights, biases, before, into, after):
    """Values of a layer from those before it, points in columns; rows after the last output are zero."""
    rows = _padded(biases.shape[0], ROWS)
    for row in range(rows):
        bias = biases[row] if row < biases.shape[0] else f4(0)
        values = after[row]
        for point in range(BLOCK):
            values[point] = bias
    add_product(address(weights), into, 1, address(before), BLOCK, address(after), BLOCK, rows, BLOCK, into)


@compiled
def _find_sensitivity(weights, hidden, channels, into_hidden, found):
    """The first output's derivative to the inputs, points in columns: W_1^T (W_2's first row where the hidden values are > 0)."""
    count, rows = into_hidden.shape[0], _padded(channels, ROWS)
    for row in range(count):
        weight, values, pulled = weights[1, row], hidden[row], into_hidden[row]
        for point in range(BLOCK):
            pulled[point] = weight if values[point] > f4(0) else f4(0)
    _clear(found, rows, BLOCK)
    add_product(address(weights[0]), 1, channels, address(into_hidden), BLOCK, address(found), BLOCK, rows, BLOCK, count)


@compiled
def _evaluate_chunk(frame, chunk):
    """Values of a chunk of points, and the first one's sensitivity."""
    layers, count = (argument_count(frame) - 1) // 2, argument_size(frame, 0, 1)
    widths = _widths(frame, layers)
    channels, outputs, widest = widths[0], widths[layers], _padded(widths.max(), ROWS)
    weights = _padded_weights(frame, widths)
    inputs, values = argument(frame, 0, (channels, count), np.float32), result(frame, 0, (outputs, count), np.float32)
    blocks, pulled = np.zeros((2, widest, BLOCK), f4), np.empty((2, widest, BLOCK), f4)
    for first in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count), BLOCK):
        size = min(BLOCK, count - first)
        _take_columns(inputs, first, size, blocks[0])
        for layer in range(layers):
            _, biases = _weights(frame, layer, widths)
            after = blocks[(layer + 1) % 2]
            _layer_there(weights[layer], biases, blocks[layer % 2], widths[layer], after)
            if layer < layers - 1:
                _relu(after, biases.shape[0], BLOCK)
        last = blocks[layers % 2]
        for row in range(outputs):
            _copy(last[row], values[row, first:], size)
        if result_count(frame) > 1:  # there is one hidden layer, and its values are still in the other block
            sensitivity = result(frame, 1, (channels, count), np.float32)
            _find_sensitivity(weights, blocks[1], channels, pulled[0, : widths[1]], pulled[1])
            for row in range(channels):
                _copy(pulled[1, row], sensitivity[row, first:], size)


@compiled
def _transposed_weights(frame, widths, forth, back):
    """Weights of each layer (inputs, padded outputs) into `forth` and (outputs, padded inputs) into `back`, both zero before."""
    for layer in range(widths.shape[0] - 1):
        weights, _ = _weights(frame, layer, widths)
        outputs, inputs = weights.shape
        row_forth, row_back = _padded(outputs, LANES), _padded(inputs, LANES)
        for out in range(outputs):
            for into in range(inputs):
                forth[layer, into * row_forth + out] = weights[out, into]
                back[layer, out * row_back + into] = weights[out, into]


@compiled
def _layer_again(forth, biases, before, by_point, into, after):
    """Hidden values, points in rows of `after`; those before it lie in columns where `by_point` is not."""
    columns = _padded(biases.shape[0], LANES)
    for point in range(BLOCK):
        _copy(biases, after[point], biases.shape[0])
    row, step = (before.shape[1], 1) if by_point else (1, before.shape[1])
    add_product(address(before), row, step, address(forth), columns, address(after), after.shape[1], BLOCK, columns, into)
    _relu(after, BLOCK, columns)


@compiled
def _add_gradient(before, by_point, delta, into, out, gradient):
    """Sums over a block's points of value times cotangent; after those of the weights (inputs, padded outputs) the biases'."""
    columns, rows = _padded(out, LANES), _padded(into, ROWS)
    row, step = (1, before.shape[1]) if by_point else (before.shape[1], 1)
    add_product(address(before), row, step, address(delta), delta.shape[1], address(gradient), columns, rows, columns, BLOCK)
    biases = gradient[into * columns : (into + 1) * columns]
    for point in range(BLOCK):
        cotangents = delta[point]
        for column in range(columns):
            biases[column] += cotangents[column]


@compiled
def _add_sensitivity_gradient(cotangent, forth, back, hidden, pulled, widths, of_first, of_second):
    """What the sensitivity's cotangent, points in columns, adds to the gradients of both layers; none goes to the inputs."""
    channels, columns, outputs = widths[0], _padded(widths[1], LANES), _padded(widths[2], LANES)
    _clear(pulled, BLOCK, columns)
    add_product(address(cotangent), 1, BLOCK, address(forth), columns, address(pulled), pulled.shape[1], BLOCK, columns, channels)
    of_first_output = np.zeros(columns, f4)
    for point in range(BLOCK):
        values, row = hidden[point], pulled[point]
        for column in range(columns):
            of_first_output[column] += row[column] if values[column] > f4(0) else f4(0)
            row[column] = back[column] if values[column] > f4(0) else f4(0)
    for column in range(widths[1]):
        of_second[column * outputs] += of_first_output[column]
    rows = _padded(channels, ROWS)
    add_product(address(cotangent), BLOCK, 1, address(pulled), pulled.shape[1], address(of_first), columns, rows, columns, BLOCK)


@compiled
def _go_back(back, delta, inputs, outputs, found):
    """Cotangent of a layer's inputs from that of its outputs, points in rows."""
    columns = _padded(inputs, LANES)
    _clear(found, BLOCK, columns)
    add_product(
        address(delta), delta.shape[1], 1, address(back), columns, address(found), found.shape[1], BLOCK, columns, outputs
    )


@compiled
def _mask(values, hidden, columns):
    """Zero where the hidden values are not > 0: ReLU on the way back."""
    for point in range(BLOCK):
        row, reference = values[point], hidden[point]
        for column in range(columns):
            row[column] = row[column] if reference[column] > f4(0) else f4(0)


@compiled
def _places(widths):
    """Where each layer's part of a chunk's sums begins, and their end."""
    places = np.zeros(widths.shape[0], np.int64)
    for layer in range(widths.shape[0] - 1):
        places[layer + 1] = places[layer] + _padded(widths[layer] + 1, ROWS) * _padded(widths[layer + 1], LANES)
    return places


@compiled
def _back_chunk(frame, chunk):
    """A chunk's gradient of the inputs, and its part of the layers' gradients."""
    layers = result_count(frame) // 2 - 1
    widths, count, places = _widths(frame, layers), argument_size(frame, 0, 1), _places(_widths(frame, layers))
    channels, outputs, widest = widths[0], widths[layers], _padded(widths.max(), LANES)
    inputs = argument(frame, 0, (channels, count), np.float32)
    cotangent = argument(frame, 1 + 2 * layers, (outputs, count), np.float32)
    gradient = result(frame, 0, (channels, count), np.float32)
    chunks, room = result_size(frame, 1 + 2 * layers, 0), result_size(frame, 1 + 2 * layers, 1)
    sums = result(frame, 1 + 2 * layers, (chunks, room), np.float32)[chunk]
    for place in range(room):
        sums[place] = f4(0)
    forth, back = np.zeros((layers, widest * widest), f4), np.zeros((layers, widest * widest), f4)
    _transposed_weights(frame, widths, forth, back)
    taken, hidden = np.zeros((2, _padded(channels, ROWS), BLOCK), f4), np.zeros((layers, BLOCK, widest), f4)
    deltas = np.empty((2, BLOCK, widest), f4)
    for first in range(chunk * CHUNK, min((chunk + 1) * CHUNK, count), BLOCK):
        size = min(BLOCK, count - first)
        _take_columns(inputs, first, size, taken[0])
        for layer in range(layers - 1):
            before = hidden[layer] if layer > 0 else taken[0]
            _, biases = _weights(frame, layer, widths)
            _layer_again(forth[layer], biases, before, layer > 0, widths[layer], hidden[layer + 1])
        delta = deltas[layers % 2]
        _clear(delta, BLOCK, _padded(outputs, LANES))
        for row in range(outputs):
            source = cotangent[row, first:]
            for point in range(size):
                delta[point, row] = source[point]
        for layer in range(layers - 1, -1, -1):
            before = hidden[layer] if layer > 0 else taken[0]
            delta, found = deltas[(layer + 1) % 2], deltas[layer % 2]
            _add_gradient(before, layer > 0, delta, widths[layer], widths[layer + 1], sums[places[layer] :])
            _go_back(back[layer], delta, widths[layer], widths[layer + 1], found)
            if layer > 0:
                _mask(found, hidden[layer], _padded(widths[layer], LANES))
        for row in range(channels):
            target = gradient[row, first:]
            for point in range(size):
                target[point] = deltas[0, point, row]
        if argument_count(frame) > 2 + 2 * layers:
            pulled = argument(frame, 2 + 2 * layers, (channels, count), np.float32)
            _take_columns(pulled, first, size, taken[1])
            of_first, of_second = sums, sums[places[1] :]
            _add_sensitivity_gradient(taken[1], forth[0], back[1], hidden[1], deltas[1], widths, of_first, of_second)


@compiled
def _join_chunks(frame):
    """Sums of all chunks, in their order, as gradients of the layers."""
    layers = result_count(frame) // 2 - 1
    widths = _widths(frame, layers)
    places = _places(widths)
    chunks, room = result_size(frame, 1 + 2 * layers, 0), result_size(frame, 1 + 2 * layers, 1)
    sums = result(frame, 1 + 2 * layers, (chunks, room), np.float32)
    for chunk in range(1, chunks):
        for place in range(room):
            sums[0, place] += sums[chunk, place]
    for layer in range(layers):
        into, out = widths[layer], widths[layer + 1]
        weights = result(frame, 1 + 2 * layer, (out, into), np.float32)
        biases, columns = result(frame, 2 + 2 * layer, (out,), np.float32), _padded(out, LANES)
        for row in range(out):
            for column in range(into):
                weights[row, column] = sums[0, places[layer] + column * columns + row]
            biases[row] = sums[0, places[layer] + into * columns + row]


_address_of_evaluation, _address_of_back = address_of(_evaluate_chunk, 2), address_of(_back_chunk, 2)


@handler
def evaluate(frame):
    """Values (outputs, n) and, where there is a second result, the first one's sensitivity to the inputs (channels, n)."""
    if executes(frame):
        in_chunks_of(frame, _address_of_evaluation(), argument_size(frame, 0, 1), CHUNK)
    return 0


@handler
def evaluate_back(frame):
    """Gradients of the inputs, then of each layer's weights and biases; last, room for each chunk's sums (chunks, numbers)."""
    if executes(frame):
        in_chunks_of(frame, _address_of_back(), argument_size(frame, 0, 1), CHUNK)
        _join_chunks(frame)
    return 0
