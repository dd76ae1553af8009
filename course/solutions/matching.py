"""Solutions of notebooks 04 to 07: costs, networks, SGM."""

import numpy as np

# --- 04 ZNCC ----------------------------------------------------------------------------------------------


# --- 05 MC-CNN --------------------------------------------------------------------------------------------


def my_cosine_cost(f_i, f_j):
    # The lengths leave the direction alone to be compared.
    cosine = f_i @ f_j / (np.linalg.norm(f_i) * np.linalg.norm(f_j))
    return (1 - cosine) / 2


def my_hinge(positive, negative, margin):
    # A ray whose match is ahead by more than the margin costs nothing, however far it is ahead.
    each = np.maximum(0, margin + negative - positive)
    return each.mean()


def my_patch_size(layers, kernel):
    # One pixel sees itself; each convolution adds half a kernel on both sides.
    return 1 + layers * (kernel - 1)


def my_unit_features(features):
    length = np.linalg.norm(features, axis=0)  # one for each pixel
    return features / np.where(length > 0, length, 1)


def my_patches(panorama, rows, columns, half):
    W = panorama.shape[1]
    around = np.arange(-half, half + 1)
    padded = np.pad(panorama, ((half, half), (0, 0)))  # zeros above and below
    y = rows[:, None, None] + half + around[:, None]  # half rows further down in the padded panorama
    x = (columns[:, None, None] + around) % W
    return padded[y, x]


# --- 06 SweepNet ------------------------------------------------------------------------------------------


def my_labels(gt_index, n):
    labels = np.where(np.rint(gt_index) == n, 0.0, 1.0)  # a match is 0, as in every cost
    return np.where(np.isnan(gt_index), np.nan, labels)  # NaN equals nothing: it would become a 1


def my_loss(cost, label):
    # The cost is the probability of *no* match. Two means, so that neither kind wins by its number.
    positives = -np.log(1 - cost[label == 0]).mean()
    negatives = -np.log(cost[label == 1]).mean()
    return (positives + negatives) / 2


def my_receptive_field(layers):
    size, pixel = 1, 1  # in pixels of the input: what one value sees, and how far its neighbour's view lies
    for kernel, stride in layers:
        size += (kernel - 1) * pixel
        pixel *= stride  # counts for the layers behind this one
    return size


def my_normalized(images):
    mean = np.nanmean(images, axis=(1, 2), keepdims=True)
    deviation = np.nanstd(images, axis=(1, 2), keepdims=True)
    return np.nan_to_num((images - mean) / deviation)  # what is not visible gets the mean, 0


def my_convolution(image, kernel):
    H, W = image.shape
    half = len(kernel) // 2
    padded = np.pad(image, ((half, half), (0, 0)))  # zeros above and below
    result = np.zeros((H, W))
    for i in range(len(kernel)):
        for j in range(len(kernel)):
            # np.roll goes around the seam: column c gets what is j - half columns to its right.
            result += kernel[i, j] * np.roll(padded[i : i + H], half - j, axis=1)
    return result


# --- 07 SGM -----------------------------------------------------------------------------------------------
