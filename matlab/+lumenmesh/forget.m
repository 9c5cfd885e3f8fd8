function forget (path)
% FORGET  Deletes a temporary file, if it is there.
  if exist (path, 'file')
    delete (path);
  end
end
