function part = encode(value, where)
%ENCODE  A real array as it travels to Python: its size, and its numbers by column in digits that give
%   the same numbers again. The counterpart is crtk_drivers.client.matlab.wire.

    if ~(isnumeric(value) || islogical(value)) || ~isreal(value) || ndims(value) > 2
        error('crtk:Input', '%s: pass a vector or matrix of real numbers, not a %s of size %s.', ...
            where, class(value), mat2str(size(value)));
    end
    part = struct('size', size(value), 'data', sprintf('%.17g,', double(value)));
end
